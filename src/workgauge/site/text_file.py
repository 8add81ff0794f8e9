"""Text of files that people make: UTF-8, with or without its mark; two bytes a letter are refused by name."""

from pathlib import Path

from workgauge.values.errors import SiteError

_MARKS = (b"\xff\xfe", b"\xfe\xff")
_LOOKED = 64


def is_wide(head: bytes) -> bool:
    """Return whether a file's first bytes are text in UTF-16: by its mark, or as every other byte is nought."""
    start = head[: min(len(head), _LOOKED) // 2 * 2]
    return start.startswith(_MARKS) or (
        len(start) >= 4 and any(not any(start[k::2]) and all(start[1 - k :: 2]) for k in (0, 1))
    )


def refuse_wide(path: Path, head: bytes) -> None:
    """Refuse text in UTF-16.

    Raises:
        SiteError: it is.
    """
    if is_wide(head):
        raise SiteError("is text in UTF-16, which is not read", file=path, allowed="text saved as UTF-8")


def text_of(path: Path) -> str:
    """Return the text of a file; bytes that are none are replaced.

    Raises:
        SiteError: the file cannot be read, or is in UTF-16.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    refuse_wide(path, raw)
    return raw.decode("utf-8-sig", errors="replace")
