"""Signatures of Equinox modules in the reference: griffe reads them as dataclasses, which they are."""

from collections.abc import Iterator

import griffe

_DATACLASS = griffe.ExprName("dataclass", parent=griffe.ExprName("dataclasses"))


class EquinoxModules(griffe.Extension):
    """Mark subclasses of ``equinox.Module`` as dataclasses, before griffe's own extension writes their signatures."""

    def on_package(self, *, pkg: griffe.Module, **kwargs) -> None:
        """Called once the package is loaded."""
        for cls in _classes(pkg):
            if "__init__" not in cls.members and _is_module(cls):
                cls.decorators.append(griffe.Decorator(_DATACLASS, lineno=None, endlineno=None))
                for member in cls.members.values():
                    if member.is_attribute:
                        _take_default(member)


def _classes(parent: griffe.Object) -> Iterator[griffe.Class]:
    for member in parent.members.values():
        if member.is_alias:
            continue
        if member.is_class:
            yield member
        if member.is_class or member.is_module:
            yield from _classes(member)


def _is_module(cls: griffe.Class) -> bool:
    bases = [base for each in (cls, *cls.mro()) for base in each.bases]
    return any(isinstance(base, griffe.Expr) and base.canonical_path == "equinox.Module" for base in bases)


def _take_default(attribute: griffe.Attribute) -> None:
    """The default in ``equinox.field(default=...)``, or none."""
    call = attribute.value
    if isinstance(call, griffe.ExprCall) and call.canonical_path == "equinox.field":
        keywords = {k.name: k.value for k in call.arguments if isinstance(k, griffe.ExprKeyword)}
        attribute.value = keywords.get("default")
