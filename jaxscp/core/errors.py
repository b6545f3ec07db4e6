"""The errors of a request that cannot be solved as it stands."""


class InvalidProblem(ValueError):
    """A problem, or a guess for it, contradicts itself; the message names the field, the value and the likely cause."""


class InvalidScenario(ValueError):
    """A scenario contradicts itself; the message names each field and the likely cause."""
