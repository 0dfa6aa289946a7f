"""Pages that need nothing else: one HTML file each, in one style."""

import base64
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from parapod.sims.output.figures import Figure, render
from parapod.sims.output.results import Result, amount, as_words
from parapod.systems.core.scenario_file import dump_scenario


def render_page(
    package: str,
    filters: Mapping[str, Callable[..., Any]] | None = None,
    template: str = "page.html.jinja",
    **content: Any,
) -> str:
    """A page, with the style (`page.css.jinja`) and the figures (`figure.html.jinja`) of all.

    Args:
        package: package that has the template.
        filters: filters of the template, beside `drawn`, `amount` and `words`.
        template: name of the template.
        content: values of the template, beside `versions`.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, ".") for name in (package, __package__ or "")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    common: dict[str, Callable[..., Any]] = {"drawn": _drawn, "amount": amount, "words": as_words}
    environment.filters.update(common | dict(filters or {}))
    versions = {name: version(name) for name in ("parapod", "drake", "numpy")}
    return environment.get_template(template).render(versions=versions, **content)


def result_page(result: Result) -> str:
    """Page of one run: its figures, its metrics with their bounds, and the scenario."""
    scenario = "" if result.scenario is None else dump_scenario(result.scenario)
    return render_page(
        __package__ or "",
        template="result.html.jinja",
        result=result,
        metrics=[(metric, "") for metric in result.metrics],
        scenario=scenario,
    )


def _drawn(figure: Figure) -> str:
    """A figure as a data URI."""
    return "data:image/svg+xml;base64," + base64.b64encode(render(figure)).decode()
