"""The state machine: the next phase from the present one and facts."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.core.types import Flag, Scalar
from jaxscp.mission.phases import Phase
from jaxscp.mission.rules import Rules


class Facts(eqx.Module):
    """Inputs of the decisions, all from estimates."""

    height: Scalar
    """Of the feet over the deck, m."""
    offset: Scalar
    """Horizontal distance from the deck's centre, m."""
    in_phase: Scalar
    """s since the phase began."""
    reached: Scalar
    """s for which the target is reached."""
    off_plan: Scalar
    """Distance from the plan, m."""
    plan_over: Flag
    unseen: Scalar
    """s since the deck was seen."""
    wind: Scalar
    """Horizontal disturbance, N."""
    attempts: Int[Array, ""]
    """Approaches that were begun."""
    time: Scalar
    """s"""


def next_phase(rules: Rules, phase: Int[Array, ""], facts: Facts) -> Int[Array, ""]:
    """The phase of this period: of all changes whose phase and condition hold, the first.

    Example:
        >>> import jax.numpy as jnp
        >>> zero, one = jnp.zeros(()), jnp.ones(())
        >>> facts = Facts(zero, zero, one, zero, zero, jnp.array(False), zero, zero, jnp.array(0), one)
        >>> Phase(int(next_phase(Rules(), jnp.array(int(Phase.on_deck)), facts))).name
        'spool_up'
    """
    changes = (*_aborts(rules, facts), *_progress(rules, facts))
    present = [phase == int(before) for before, _, _ in changes]
    conditions = [here & condition for here, (_, condition, _) in zip(present, changes, strict=True)]
    codes = [jnp.asarray(int(after), phase.dtype) for _, _, after in changes]
    return jnp.select(conditions, codes, phase)


def _progress(rules: Rules, facts: Facts):
    """(phase, condition, next phase) of a mission that goes well."""
    still = facts.reached >= rules.still
    low = (facts.height < rules.low_height) & (facts.reached >= rules.low_time)
    return (
        (Phase.on_deck, facts.in_phase > 0.5, Phase.spool_up),
        (Phase.spool_up, facts.height > rules.lift_off, Phase.climb),
        (Phase.climb, still, Phase.hover),
        (Phase.cruise, facts.plan_over & still, Phase.hover),
        (Phase.approach, still & (facts.unseen < rules.deck_lost), Phase.land),
        (Phase.land, (facts.height < rules.touch_height) | low, Phase.touch_down),
        (Phase.land, (facts.height < rules.level_height) & (facts.wind > rules.calm), Phase.level_off),
        (Phase.level_off, facts.height < rules.touch_height, Phase.touch_down),
        (Phase.level_off, facts.in_phase > rules.level_time, Phase.touch_down),
        (Phase.touch_down, facts.in_phase > 0.5, Phase.landed),
        (Phase.go_around, still, Phase.approach),
    )


def _aborts(rules: Rules, facts: Facts):
    """(phase, condition, next phase) of a mission that does not."""
    cone = rules.greatest_error + rules.cone_floor + rules.cone_slope * jnp.maximum(facts.height, 0.0)
    outside = facts.offset > cone
    lost, late = facts.unseen > rules.deck_lost, facts.in_phase > rules.level_time
    near = (facts.offset < rules.near_deck) & ~lost
    over = (facts.wind > rules.strongest_wind) | (facts.time > rules.time_limit)
    given_up = over | (facts.attempts >= rules.attempts)
    return (
        (Phase.cruise, over, Phase.safe_hover),
        (Phase.hover, over, Phase.safe_hover),
        (Phase.approach, over, Phase.safe_hover),
        (Phase.approach, lost & (facts.in_phase > rules.search_time), Phase.safe_hover),
        (Phase.cruise, near & (facts.height < rules.least_height), Phase.climb),
        (Phase.cruise, facts.off_plan > rules.tracking_error, Phase.hover),
        (Phase.spool_up, facts.in_phase > 5.0, Phase.on_deck),
        (Phase.land, outside | lost, Phase.go_around),
        (Phase.level_off, late & (facts.height > rules.low_height), Phase.go_around),
        (Phase.go_around, given_up & (facts.reached >= rules.still), Phase.safe_hover),
    )
