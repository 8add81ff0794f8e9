"""Numbers as LandXML writes them: ASCII, decimal point, separated by white space."""

import math

#: No number in a file is larger; what is overflows on its way through the geometry.
LARGEST = 1e12
#: What a person is told when a list of numbers cannot be read.
HOW_TO_WRITE = "numbers with a decimal point, separated by spaces"


def to_float(word: str) -> float:
    """Return a word as a number, `inf` and `nan` included.

    Raises:
        ValueError: it is none. Python's own additions (`1_0`, digits of other scripts) are none.
    """
    if "_" in word or not word.isascii():
        raise ValueError(word)
    return float(word)


def to_int(word: str) -> int:
    """Return a word as a whole number of 64 bits.

    Raises:
        ValueError: it is none, or too large.
    """
    if "_" in word or not word.isascii() or len(word) > 20 or abs(int(word)) >= 2**63 - 1:
        raise ValueError(word)
    return int(word)


def fault(words: list[str]) -> str | None:
    """Return the first word that is no finite number, or None."""
    for word in words:
        try:
            if not math.isfinite(to_float(word)):
                return word
        except ValueError:
            return word
    return None
