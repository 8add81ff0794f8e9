"""What is wrong with a machine description, and where in it."""

Place = tuple[str | int, ...]


class DescriptionError(ValueError):
    """A description that contradicts itself: `place` is the path of keys and list indices to the offending value."""

    def __init__(self, place: Place, message: str, value: object = None, allowed: str | None = None) -> None:
        super().__init__(message)
        self.place, self.message, self.value, self.allowed = place, message, value, allowed
