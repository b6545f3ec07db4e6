"""Text of ``jaxscp info``."""

from typing import Any


def info_text(facts: dict[str, Any]) -> str:
    """Lines for people.

    Args:
        facts: from ``installation``.
    """
    lines = [
        f"jaxscp {facts['version']}, jax {facts['jax']}, Python {facts['python']}",
        f"devices: {', '.join(facts['devices'])}",
        f"cache: {facts['cache'] or 'none; --cache FOLDER, or jaxscp.use_cache, stores compiled programs'}",
        "compiled libraries:",
    ]
    for name, library in facts["libraries"].items():
        says = f"C++, {library['instructions']}" if library["serves"] else f"JAX; {library['reason']}"
        if library.get("kernel"):
            says += "; CUDA kernel"
        lines.append(f"  {name}: {says}")
    return "\n".join(lines)
