"""Statuses: their codes are an order that files and other programs rely on."""

from jaxscp import Status, status_names
from jaxscp.core.status import status_text

IN_ORDER = [
    "converged",
    "almost_converged",
    "iteration_limit",
    "infeasible",
    "unbounded",
    "insufficient_progress",
    "numerical_error",
    "dynamics_unmet",
    "constraints_unmet",
    "verification_failed",
    "invalid_input",
]


def test_codes_go_by_the_known_order():
    codes = [int(getattr(Status, name)._value) for name in IN_ORDER]
    assert codes == list(range(len(IN_ORDER)))


def test_every_status_has_its_name_and_a_message():
    for name in IN_ORDER:
        member = getattr(Status, name)
        assert status_names(member) == name
        assert len(Status[member]) > 20
        assert status_text(name, landing=True) == Status[member]
        assert len(status_text(name, landing=False)) > 20
