"""Style of all figures and plots."""

from typing import Any

# Colours that stay apart in print and for the colour-blind (Okabe and Ito), in order of use.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
# Lines of bounds.
BOUND: dict[str, Any] = {"color": "0.2", "linestyle": "--", "linewidth": 1.0}
_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "parapod",  # the same figure gives the same file
    "pdf.fonttype": 42,  # TrueType: publishers refuse Matplotlib's usual Type 3
}


def style() -> dict[Any, Any]:
    """Settings of Matplotlib for all figures."""
    from cycler import cycler

    return {**_STYLE, "axes.prop_cycle": cycler(color=COLOURS)}
