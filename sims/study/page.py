"""Page of a study: one HTML file that needs nothing else."""

from collections.abc import Iterator, Sequence

from parapod.sims.lab.pages import render_page
from parapod.sims.output.figures import Figure
from parapod.sims.study.figures import MAP
from parapod.sims.study.study import Study
from parapod.sims.study.summary import QUANTILES, Summary


def make_page(
    study: Study,
    summary: Summary,
    figures: Sequence[Figure],
    template: str = "page.html.jinja",
    refresh: int = 0,
) -> str:
    """The page.

    Args:
        study: the study.
        summary: summary of the runs.
        figures: its figures.
        template: "page.html.jinja", or "part.html.jinja" for its body alone.
        refresh: time after which a browser looks again, of a study that is running [s]; 0: never.
    """
    return render_page(
        "parapod.sims.study",
        template=template,
        study=study,
        refresh=refresh,
        summary=summary,
        maps=[figure for figure in figures if figure.name.startswith(MAP)],
        figures=[figure for figure in figures if not figure.name.startswith(MAP)],
        quantiles=QUANTILES,
        commands=list(_commands(summary)),
    )


def _commands(summary: Summary) -> Iterator[tuple[int, str, str]]:
    """Number of a run, why it is shown, and the command that repeats it."""
    for run, command in summary.commands.items():
        keys = [metric.key for metric in summary.worst if metric.worst == run]
        why = [f"worst of {', '.join(keys)}"] if keys else []
        why += [text for text, _, first in summary.refusals if first == run]
        yield run, "; ".join(why), command
