"""Keys of a scenario that take one of several words or a mapping, with one clear complaint for anything else."""

from typing import Any

from pydantic import BaseModel, Discriminator


def in_words(words: tuple[str, ...], mapping: str) -> Discriminator:
    """Return what tells one of several words from a mapping; the tags begin with `<` and name no key."""

    def tag(given: Any) -> str | None:
        if isinstance(given, dict | BaseModel):
            return "<mapping>"
        return "<word>" if given in words else None

    return Discriminator(
        tag,
        custom_error_type="neither",
        custom_error_message=f"is neither {' nor '.join(f'`{word}`' for word in words)} nor {mapping}",
    )
