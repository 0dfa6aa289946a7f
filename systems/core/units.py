"""Units of the elements of signals, and units in which people read them."""

import math
import re

# Units that people read, and by how much their numbers are larger.
READ = {
    "m": ("mm", 1e3),
    "m/s": ("mm/s", 1e3),
    "rad": ("deg", math.degrees(1.0)),
    "rad/s": ("deg/s", math.degrees(1.0)),
}

_SYMBOLS = {"A", "N", "T", "V", "code", "deg", "kg", "m", "mm", "rad", "s"}
_SYMBOL = re.compile(r"(-|0/1)|[A-Za-z]+(?:\^\d)?(?:[ /][A-Za-z]+(?:\^\d)?)*")


def units_of(unit: str, size: int) -> list[str]:
    """Unit of each element of a signal.

    | unit | of |
    |---|---|
    | V | all elements |
    | rad, rad, m | three elements, or the same again of each further three |
    | m, m/s | positions, and then as many rates |
    | rad, rad, m and rates | three elements, and then their rates |

    Args:
        unit: unit of the declaration.
        size: number of elements.

    Raises:
        ValueError: an unknown unit, or a number of units that does not fit the elements.
    """
    base, rates = re.fullmatch(r"(.*?)(,? and (?:their )?rates)?", unit).groups()  # type: ignore[union-attr]
    each = [text.strip() for text in base.split(",")]
    for text in each:
        symbol = _SYMBOL.fullmatch(text)
        if not symbol or not (symbol[1] or set(re.findall("[A-Za-z]+", text)) <= _SYMBOLS):
            admissible = ", ".join(sorted(_SYMBOLS))
            raise ValueError(
                f"'{text}' is not a unit; admissible are -, 0/1 and combinations of {admissible}, "
                "such as m/s^2 or N m"
            )
    if rates:
        each += [f"{text}/s" for text in each]
    times, rest = divmod(size, len(each))
    if rest or not times:
        raise ValueError(f"'{unit}' has units of {len(each)} elements, not of {size}")
    if all("/s" in text for text in each[1:]):
        return [text for text in each for _ in range(times)]
    return each * times
