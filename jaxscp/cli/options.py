"""Options of a command as one dataclass, instead of one argument each."""

import dataclasses
import inspect
import typing
from collections.abc import Callable
from typing import Any


def with_options(options: type) -> Callable[[Callable[[Any], None]], Callable[..., None]]:
    """Decorator: a function of one dataclass becomes a command with an option for each of its fields.

    Args:
        options: a dataclass whose fields are annotated as Typer asks for; one without a default is required.

    Example:
        >>> import dataclasses
        >>> @dataclasses.dataclass
        ... class Size:
        ...     width: int = 1
        >>> @with_options(Size)
        ... def area(size):
        ...     print(size.width**2)
        >>> area(width=3)
        9
    """
    hints = typing.get_type_hints(options, include_extras=True)
    parameters = [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in dataclasses.fields(options)
    ]

    def decorate(function: Callable[[Any], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            function(options(**values))

        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
        command.__annotations__ = hints
        return command

    return decorate
