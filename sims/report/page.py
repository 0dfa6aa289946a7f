"""The report as one HTML file that needs nothing else."""

import base64
import io
import math
import re
import shlex
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from parapod.sims.lab.pages import render_page
from parapod.sims.output.results import Result
from parapod.sims.report.chapter import Picture, Relation, Tone
from parapod.sims.report.run import ChapterRun, PartRun

_INDEX = re.compile(r"([A-Za-zΑ-Ωα-ωϕ∇])_([A-Za-z0-9]+)")

_CODE = re.compile(r"`([^`]+)`")


def make_page(runs: Sequence[ChapterRun], quick: bool, date: str) -> str:
    """The report.

    Args:
        runs: the chapters.
        quick: true for the quick report.
        date: date of the report.
    """
    return render_page(
        "parapod.sims.report",
        {"indexed": _indexed, "coded": _coded, "photo": _photo},
        chapters=[_chapter(run, quick) for run in runs],
        quick=quick,
        date=date,
    )


def counts(run: ChapterRun) -> dict[str, int]:
    """Number of claims of each verdict, the good ones first."""
    order = list(Tone)
    verdicts = [claim.verdict(run.numbers) for claim in run.chapter.claims]
    words = [
        ("better" if "better" in v.word else v.word)
        for v in sorted(verdicts, key=lambda v: order.index(v.tone))
    ]
    return dict(Counter(words))


def _chapter(run: ChapterRun, quick: bool) -> dict[str, Any]:
    numbers = run.numbers
    claims_used = [claim for claim in run.chapter.claims if claim.relation is Relation.USED]
    return {
        "run": run,
        "chapter": run.chapter,
        "claims": [
            [
                (claim, claim.shown(numbers), claim.verdict(numbers))
                for claim in run.chapter.claims
                if (claim.relation is Relation.USED) is is_input
            ]
            for is_input in (False, True)
        ],
        "used": sum(claim.verdict(numbers).tone is not Tone.BAD for claim in claims_used),
        "counts": counts(run),
        "contradicts": not all(check.passed for check in run.checks),
        "bounds": _bounds(run),
        "errata": list(zip(run.chapter.errata, run.checks, strict=True)),
        "parts": [_part(part, numbers.results, quick) for part in run.parts],
    }


def _bounds(run: ChapterRun) -> dict[str, int]:
    metrics = [
        metric
        for part in run.parts
        for result in part.results
        for metric in result.metrics
        if metric.is_bounded
    ]
    return {"held": sum(metric.passed for metric in metrics), "all": len(metrics)}


def _part(run: PartRun, others: Mapping[str, Result], quick: bool) -> dict[str, Any]:
    """Content of a part; `others` are the results of all of them."""
    part = run.part
    overrides = [*part.overrides, *(part.quick if quick else ())]
    before = others.get(part.adds_to)
    metrics, figures, notes = (
        [item for item in _shown(run.result, what) if not _is_among(item, _shown(before, what))]
        for what in ("metrics", "figures", "notes")
    )
    return {
        "run": run,
        "part": part,
        "text": (quick and part.quick_text) or part.text,
        "command": shlex.join(
            ["parapod", "run", part.experiment, *(["--set", *overrides] if overrides else [])]
        ),
        "metrics": [(metric, _spread(run, metric.key)) for metric in metrics],
        "figures": figures,
        "notes": notes,
    }


def _shown(result: Result | None, what: str) -> tuple[Any, ...]:
    return () if result is None else getattr(result, what)


def _is_among(item: Any, others: Sequence[Any]) -> bool:
    """Whether another result has a metric of the same key, a figure of the same name or a note."""
    for name in ("key", "name"):
        if hasattr(item, name):
            return getattr(item, name) in [getattr(other, name) for other in others]
    return item in others


def _spread(run: PartRun, key: str) -> str:
    """Smallest, middle and largest value of a metric; empty if there is one seed only."""
    values = [one.value for result in run.seeds for one in result.metrics if one.key == key]
    if not values:
        return ""
    if any(map(math.isnan, values)):
        return "- / - / -"
    spread = min(values), statistics.median(values), max(values)
    return " / ".join(f"{value:.3g}" if math.isfinite(value) else "-" for value in spread)


def _indexed(text: str) -> Markup:
    """Text in which K_v gets its index."""
    return Markup(_INDEX.sub(r"\1<sub>\2</sub>", str(escape(text))))


def _coded(text: str) -> Markup:
    """Text in which what stands between backticks is code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


def _photo(picture: Picture) -> str:
    """A picture as a data URI."""
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, picture.pixels, format="png")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
