"""Default scalar types of TemplateSystems, with the names and arguments that people use."""

import inspect
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from pydrake.common import cpp_template


def for_floats(template: Any) -> Any:
    """The class of a TemplateSystem for floats, named and documented as if it were written so.

    A notebook's completion then shows the arguments of `_construct`, and `repr` the plain name.

    Args:
        template: the TemplateSystem, such as `PiController_`.
    """
    with _quick_stack():
        instance = template[None]
    signature = inspect.signature(instance._construct)
    arguments = [
        argument
        for name, argument in signature.parameters.items()
        if name not in ("self", "converter")
    ]
    instance.__signature__ = signature.replace(
        parameters=arguments, return_annotation=inspect.Signature.empty
    )
    instance.__name__ = instance.__qualname__ = template.name.rstrip("_")
    instance.__repr__ = lambda system: f"<{instance.__name__} '{system.get_name()}'>"
    return instance


@contextmanager
def _quick_stack() -> Iterator[None]:
    """Lets Drake find the module that calls it without reading the source of all callers.

    It asks for each method that it adds to a class, and that took a tenth of a program's start.
    """

    def calling_module(frame: int = 2) -> ModuleType:
        return sys.modules[sys._getframe(frame).f_globals["__name__"]]

    name = "_get_module_from_stack"
    if (slow := getattr(cpp_template, name, None)) is None:  # not public: it may go
        yield
        return
    setattr(cpp_template, name, calling_module)
    try:
        yield
    finally:
        setattr(cpp_template, name, slow)
