"""Page of a study: one HTML file that needs nothing else."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from parapod.sims.lab.pages import render_page
from parapod.sims.study.summary import QUANTILES, Summary

if TYPE_CHECKING:
    from parapod.sims.study.result import StudyResult


def make_page(result: "StudyResult", template: str = "page.html.jinja") -> str:
    """The page.

    Args:
        result: the study and what came out.
        template: "page.html.jinja", or "part.html.jinja" for its body alone.
    """
    return render_page(
        "parapod.sims.study",
        template=template,
        study=result.study,
        summary=result.summary,
        figures=result.figures,
        quantiles=QUANTILES,
        commands=list(_commands(result.summary)),
    )


def _commands(summary: Summary) -> Iterator[tuple[int, str, str]]:
    """Number of a run, why it is shown, and the command that repeats it."""
    for run, command in summary.commands.items():
        keys = [metric.key for metric in summary.worst if metric.worst == run]
        why = [f"worst of {', '.join(keys)}"] if keys else []
        why += [text for text, _, first in summary.refusals if first == run]
        yield run, "; ".join(why), command
