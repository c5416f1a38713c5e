"""The symmetries of the grid: rotations and reflections of maps, and of the actions that belong to them.

A city that is rotated or reflected is as good a city. So every observation stands for up to eight. A learner can learn from all
of them, and an agent can ask its network for all of them and take the mean. In CPP, whoever flies in a reflected city meets
the same rewards. In a rotated city and in DH they may differ a little, because a line of sight that passes a corner goes first
along the column, and because positions halfway between two cells are rounded to the even row or column.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from uavbench.world.city import OFFSETS

_MOVES: list[tuple[int, int]] = [(down, right) for down, right in OFFSETS[:4].tolist()]


@dataclass(frozen=True)
class Symmetry:
    """One of the eight: it may swap rows and columns, and after that reverse the order of the rows, and of the columns.

    Attributes
    ----------
    transpose, reverse_rows, reverse_columns : bool
    """

    transpose: bool = False
    reverse_rows: bool = False
    reverse_columns: bool = False

    @cached_property
    def actions(self) -> tuple[int, ...]:
        """What becomes of each of the six actions: the moves change their direction, ``hover`` and ``land`` remain."""
        return (*(_MOVES.index(self.direction(*move)) for move in _MOVES), 4, 5)

    def direction(self, down: Any, right: Any) -> tuple[Any, Any]:
        """Return what becomes of a direction, given by how far it leads down and to the right."""
        if self.transpose:
            down, right = right, down
        return -down if self.reverse_rows else down, -right if self.reverse_columns else right

    def maps(self, maps: Any) -> Any:
        """Return what becomes of maps: PyTorch tensors whose last two axes are rows and columns."""
        turned = maps.transpose(-1, -2) if self.transpose else maps
        axes = [axis for axis, reversed_ in ((-2, self.reverse_rows), (-1, self.reverse_columns)) if reversed_]
        return turned.flip(axes) if axes else turned

    def restored(self, maps: Any) -> Any:
        """Return the maps of which `maps` makes these: what a network says of cells of a turned map belongs to them."""
        axes = [axis for axis, reversed_ in ((-2, self.reverse_rows), (-1, self.reverse_columns)) if reversed_]
        turned = maps.flip(axes) if axes else maps
        return turned.transpose(-1, -2) if self.transpose else turned


#: The symmetry that changes nothing.
IDENTITY = Symmetry()


def symmetries_of(shape: tuple[int, int]) -> tuple[Symmetry, ...]:
    """Return the symmetries of maps of a shape (M, N), the identity first: eight, or four if the maps are not square."""
    return tuple(Symmetry(*each) for each in product([False, True] if shape[0] == shape[1] else [False], *[[False, True]] * 2))
