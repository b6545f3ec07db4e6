"""Differentiable six-degree-of-freedom trajectory optimisation by sequential convex programming."""

from jaxscp import airframes as airframes
from jaxscp import corridor as corridor
from jaxscp import scenarios as scenarios
from jaxscp.certificate import Certificate as Certificate
from jaxscp.certificate import certify as certify
from jaxscp.convexify import NormTrustRegion as NormTrustRegion
from jaxscp.convexify import ProximalTrustRegion as ProximalTrustRegion
from jaxscp.mission import BodyState as BodyState
from jaxscp.mission import Components as Components
from jaxscp.mission import Ellipsoids as Ellipsoids
from jaxscp.mission import FlightLimits as FlightLimits
from jaxscp.mission import LandingScenario as LandingScenario
from jaxscp.mission import Weights as Weights
from jaxscp.mission import at_rest as at_rest
from jaxscp.mission import ellipsoids as ellipsoids
from jaxscp.mission import fixed as fixed
from jaxscp.mission import flight_limits as flight_limits
from jaxscp.newton import NewtonSCP as NewtonSCP
from jaxscp.planner import Planner as Planner
from jaxscp.planner import Solution as Solution
from jaxscp.scp import SCP as SCP
from jaxscp.status import Status as Status
from jaxscp.status import status_names as status_names
from jaxscp.trajectory import Trajectory as Trajectory
from jaxscp.validation import InvalidScenario as InvalidScenario
from jaxscp.validation import validate as validate
