"""Types of settings that say which numbers make sense; `pipeline.config` refuses the others."""

import math
from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class Range:
    """Hold the bounds of a number, which may take them unless they are open."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False

    def __contains__(self, value: float) -> bool:
        """Say whether a number is finite and lies inside."""
        above = self.low < value if self.open_low else self.low <= value
        below = value < self.high if self.open_high else value <= self.high
        return abs(value) < math.inf and above and below

    def __str__(self) -> str:
        """Say what is expected, as in `a number, above 0`."""
        low = "" if self.low == -math.inf else f"{'above' if self.open_low else 'at least'} {self.low:g}"
        high = "" if self.high == math.inf else f"{'below' if self.open_high else 'at most'} {self.high:g}"
        return " and ".join(filter(None, (low, high)))


@dataclass(frozen=True)
class PowersOfTwo:
    """Hold the powers of two from one of them on."""

    low: int

    def __contains__(self, value: int) -> bool:
        """Say whether a number is one of them."""
        return value >= self.low and not value & (value - 1)

    def __str__(self) -> str:
        """Say what is expected, as in `a whole number, a power of two from 4`."""
        return f"a power of two from {self.low}"


Count = Annotated[int, Range(1)]
Natural = Annotated[int, Range(0)]
"""How many, where 0 leaves it out."""
Positive = Annotated[float, Range(0, open_low=True)]
NonNegative = Annotated[float, Range(0)]
Several = Annotated[int, Range(2)]
Frames = Annotated[int, Range(1, 120)]
"""Of an animation of 2.4 seconds: viewers of GIFs show none for less than a fiftieth of a second."""
Fraction = Annotated[float, Range(0, 1)]
"""A fraction of a whole, such as of all iterations."""
Rim = Annotated[float, Range(0, 0.5)]
"""A share of points that lie outermost to one side."""
Momentum = Annotated[float, Range(0, 1, open_high=True)]
"""How much of a running mean a step keeps, such as Adam's betas."""
Angle = Annotated[float, Range(0, 180)]
"""The size of an angle, in degrees."""
Azimuth = Annotated[float, Range(-360, 360)]
"""An angle around the vertical, in degrees."""
Concentration = Annotated[float, Range(0, 1000, open_low=True)]
"""How narrow a distribution of angles is; more than that is narrower than what angles are counted in."""
TextureSize = Annotated[int, PowersOfTwo(4)]
"""Texels a side: generators begin with 4 and double them."""
Elevation = Annotated[float, Range(-90, 90)]
"""An angle above the horizon, in degrees."""
