"""Differentiable six-degree-of-freedom trajectory optimisation by sequential convex programming."""

from jaxscp import airframes as airframes
from jaxscp import corridor as corridor
from jaxscp import scenarios as scenarios
from jaxscp.certificate import Certificate as Certificate
from jaxscp.certificate import certify as certify
from jaxscp.convexify import NormTrustRegion as NormTrustRegion
from jaxscp.convexify import ProximalTrustRegion as ProximalTrustRegion
from jaxscp.landing import BodyState as BodyState
from jaxscp.landing import LandingScenario as LandingScenario
from jaxscp.landing import Weights as Weights
from jaxscp.landing import at_rest as at_rest
from jaxscp.newton import NewtonSCP as NewtonSCP
from jaxscp.planner import Planner as Planner
from jaxscp.planner import Solution as Solution
from jaxscp.scp import SCP as SCP
from jaxscp.status import Status as Status
from jaxscp.status import status_names as status_names
from jaxscp.trajectory import Trajectory as Trajectory
from jaxscp.validation import InvalidScenario as InvalidScenario
from jaxscp.validation import validate as validate
