"""Names of the twelve branches, as the paper numbers them: leg, then branch."""

from collections.abc import Sequence

from parapod.systems.walking_chair.geometry import LEG_COUNT

# Of a leg: the UP branch, and the two UPS branches.
BRANCHES_OF_LEG = (1, 2, 3)
LEGS = tuple(range(1, LEG_COUNT + 1))


def branch_names(legs: Sequence[int] = LEGS) -> tuple[str, ...]:
    """Names as in "branch 12" (leg 1, first UPS branch) of the legs' branches, leg by leg."""
    return tuple(f"branch {leg}{branch}" for leg in legs for branch in BRANCHES_OF_LEG)


BRANCHES = branch_names()
