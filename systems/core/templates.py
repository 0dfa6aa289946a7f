"""Default scalar types of TemplateSystems, with the names and arguments that people use."""

import inspect
from typing import Any


def for_floats(template: Any) -> Any:
    """The class of a TemplateSystem for floats, named and documented as if it were written so.

    A notebook's completion then shows the arguments of `_construct`, and `repr` the plain name.

    Args:
        template: the TemplateSystem, such as `PiController_`.
    """
    made = template[None]
    signature = inspect.signature(made._construct)
    arguments = [
        argument
        for name, argument in signature.parameters.items()
        if name not in ("self", "converter")
    ]
    made.__signature__ = signature.replace(
        parameters=arguments, return_annotation=inspect.Signature.empty
    )
    made.__name__ = made.__qualname__ = template.name.rstrip("_")
    made.__repr__ = lambda system: f"<{made.__name__} '{system.get_name()}'>"
    return made
