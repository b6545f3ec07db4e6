"""Pictures show the numbers they are named for; the report holds them all."""

import re

import numpy as np
import pytest

import jaxscp
from jaxscp import monte_carlo as mc

INTEGRATION = 1e-6  # of the rollout, against a closed form


def run(case):
    along = np.linspace(0.0, 1.0, 6)
    state = np.stack([along, case["wind"] * along], axis=1)
    good = bool(abs(case["wind"]) < 0.5)
    return mc.Outcome({"success": good, "cost": case["mass"] + 0.1 * case["wind"]}, {"state": state})


def rising(case):
    return mc.Outcome({"success": True, "cost": case["mass"] ** 2})


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    parameters = (
        mc.Parameter("mass", mc.Uniform(0.9, 1.1), unit="kg"),
        mc.Parameter("wind", mc.Normal(0.0, 0.4)),
    )
    study = mc.Study(run, {"mass": 1.0, "wind": 0.0}, parameters, mc.Independent(300, 1))
    folder = tmp_path_factory.mktemp("pictures") / "s"
    return mc.sweep(study, folder, keep=mc.FailedTrajectories(every=20), chunk=300)


def test_the_map_has_the_share_of_each_cell(result):
    axes = mc.draw_success_map(result, "mass", "wind", bins=4).axes[0]
    shares = np.ma.filled(axes.collections[0].get_array(), np.nan).ravel()
    counts, x, y = np.histogram2d(result.values("mass"), result.values("wind"), bins=4)
    good = np.histogram2d(
        result.values("mass"), result.values("wind"), bins=[x, y], weights=result.values("success")
    )[0]
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(shares, (100 * good / counts).T.ravel())
    assert len(axes.lines[0].get_xdata()) == np.sum(~result.values("success"))
    assert axes.get_xlabel() == "mass [kg]"


def test_convergence_ends_at_the_share(result):
    line = mc.draw_convergence(result).axes[0].lines[-1]
    assert line.get_xdata()[-1] == 300
    assert line.get_ydata()[-1] == pytest.approx(100 * np.mean(result.values("success")))


def test_the_distribution_function_is_empirical(result):
    line = mc.draw_distributions(result, ["cost"]).axes[0].lines[0]
    good = np.sort(result.values("cost")[result.values("success")])
    np.testing.assert_array_equal(line.get_xdata(), good)


def test_the_tornado_has_the_strongest_on_top(result):
    axes = mc.draw_tornado(result, "cost").axes[0]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["wind", "mass"]
    assert axes.patches[1].get_width() == mc.rank_correlations(result, "cost")[0].value


def test_a_result_that_rises_with_a_parameter_has_a_tornado(tmp_path):
    """Rounding put the upper limit below a correlation of one."""
    parameters = (mc.Parameter("mass", mc.Uniform(0.8, 1.9)),)
    study = mc.Study(rising, {"mass": 1.0}, parameters, mc.LatinHypercube(12, 2))
    swept = mc.sweep(study, tmp_path / "s", chunk=12)
    effect = mc.rank_correlations(swept, "cost")[0]
    assert effect.lower <= effect.value == 1.0 <= effect.upper
    assert mc.draw_tornado(swept, "cost").axes[0].patches[0].get_width() == 1.0


def test_failures_are_drawn(result):
    axes = mc.draw_failures(result).axes[0]
    assert len(axes.lines) == min(60, np.sum(~result.values("success"))) + sum(
        bool(result.values("success")[n]) for n in range(0, 300, 20)
    )


def test_the_report_has_summary_pictures_and_worst_cases(result, tmp_path):
    mc.write_report(result, tmp_path / "report.html", title="Wind & mass")
    text = (tmp_path / "report.html").read_text()
    assert "Wind &amp; mass" in text
    assert len(re.findall("data:image/png;base64", text)) == 6
    assert all(f"<td>{number}</td>" in text for number in mc.summarise(result).worst)


@pytest.mark.nightly
def test_robustness_is_newtons_law(tmp_path):
    """A steady force along y moves the end by f t^2 / 2, as no attitude or thrust depends on the position."""
    scenario = jaxscp.scenarios.ascent_to_platform()
    solution = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=1))(scenario)
    wind = mc.Parameter("airframe.body.gravity", mc.Uniform(-0.1, 0.1), "wind", index=1, change=mc.Add())
    found = mc.robustness(
        solution, scenario, [wind], count=8, allowed={"error_final_position": 0.1}, folder=tmp_path
    )
    force, time = found.sweep.values("wind"), float(solution.trajectory.time[-1])
    states = found.sweep.dataset(trajectories=True)["trajectory.state"].values
    ends = states[:, -1, 1] - force * time**2 / 2
    np.testing.assert_allclose(ends, ends[0], atol=INTEGRATION)
    good = found.sweep.values("error_final_position") <= 0.1
    np.testing.assert_array_equal(found.sweep.values("success"), good)
    assert len(found.draw().axes) == 2
