"""Random instances, a tenth of them infeasible by construction, planned in batches and checked by the certificate.

python -m benchmarks.survey [--json] [--count 1000] [--batch 50]
"""

import argparse
import json
import time
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402
from jaxscp import LandingScenario, scenarios, status_names  # noqa: E402
from tests.support.random_instances import TIME_WEIGHTS, random_instances, with_time_weight  # noqa: E402

NODES = 30
TOO_SHORT = 0.6  # s: neither full thrust nor free fall reaches any goal in this time


def survey(count: int, batch_size: int, echo: Any) -> dict[str, Any]:
    """Statuses of random instances, every tenth infeasible, planned in batches, compared with the truth."""
    # Without an outer jit the planner remains two programs, and the missions share the large one.
    plan_all = jax.vmap(jaxscp.Planner(nodes=NODES))
    seen: dict[str, dict[str, int]] = {"feasible": {}, "infeasible": {}}
    failed, not_finite, iterations, worst, residuals = 0, 0, [], 0.0, []
    missions = (scenarios.platform_to_platform, scenarios.ascent_to_platform)
    began = time.perf_counter()
    for mission in missions:
        for first in range(0, -(-count // len(missions)), batch_size):
            batch, impossible = _drawn(mission, first, batch_size)
            solution = jax.tree.map(np.asarray, plan_all(batch))
            names = status_names(solution.status)
            agrees = np.asarray(jax.vmap(lambda c: c.passed())(solution.certificate)) & ~impossible
            failed += int(np.sum((names == "converged") & ~agrees))
            finite = [
                np.isfinite(leaf).reshape(batch_size, -1).all(axis=1) for leaf in jax.tree.leaves(solution)
            ]
            not_finite += int(np.sum(~np.all(finite, axis=0) & (names != "invalid_input")))
            iterations.extend(solution.iterations[names == "converged"])
            residuals.extend(solution.certificate.optimality[names == "converged"])
            for kind, which in (("feasible", ~impossible), ("infeasible", impossible)):
                for name, number in zip(*np.unique(names[which], return_counts=True), strict=True):
                    seen[kind][str(name)] = seen[kind].get(str(name), 0) + int(number)
            between, allowed = solution.certificate.between_nodes, solution.certificate.allowed
            worst = max(worst, float(np.max((between / allowed)[names == "converged"], initial=0.0)))
    for kind, statuses in seen.items():
        echo(f"{kind} random instances: " + ", ".join(f"{n} {s}" for s, n in sorted(statuses.items())))
    return {
        "verification_failed_converged": failed,
        "feasible_called_infeasible": seen["feasible"].get("infeasible", 0),
        "not_finite": not_finite,
        "statuses": seen,
        "median_iterations": float(np.median(iterations)) if iterations else None,
        "worst_violation_relative_to_allowed": worst,
        "worst_optimality_residual": float(max(residuals, default=0.0)),
        "median_optimality_residual": float(np.median(residuals)) if residuals else None,
        "seconds": time.perf_counter() - began,
    }


def _drawn(mission: Any, first: int, batch_size: int) -> tuple[LandingScenario, np.ndarray]:
    """A batch of variations of a mission at both time weights, and flags: no vehicle can fly this one."""
    batch = with_time_weight(random_instances(jax.random.key(1000 + first), batch_size, mission), 0.0)
    index = np.arange(batch_size)
    impossible = index % 10 == 9
    batch = eqx.tree_at(lambda s: s.weights.time, batch, jnp.asarray(np.choose(index % 2, TIME_WEIGHTS)))
    longest = jnp.where(impossible, TOO_SHORT, batch.dilation_max)
    return eqx.tree_at(lambda s: s.dilation_max, batch, longest), impossible


def main() -> None:
    """Plan the instances and print the counts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--count", type=int, default=1000, help="instances")
    parser.add_argument("--batch", type=int, default=50, help="of them planned at once")
    options = parser.parse_args()
    result = survey(options.count, options.batch, (lambda line: None) if options.json else print)
    if options.json:
        print(json.dumps(result))
    else:
        print("\n".join(f"{k}: {v}" for k, v in result.items() if k != "statuses"))


if __name__ == "__main__":
    main()
