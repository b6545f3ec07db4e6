# Imported on first use: see ``__init__.py``. In the order in which data flows.

# --- a problem: dynamics, cost, constraints, ends, time ---
from .dynamics.base import Dynamics as Dynamics
from .dynamics.double_integrator import DoubleIntegrator as DoubleIntegrator
from .dynamics.rigid_body import RigidBody as RigidBody
from .problem.augmented import with_integral as with_integral
from .problem.augmented import with_static as with_static
from .problem.cost import Cost as Cost
from .cones.cone import Zero as Zero
from .cones.cone import NonNegative as NonNegative
from .cones.cone import SecondOrder as SecondOrder
from .problem.constraint import Constraint as Constraint
from .problem.constraint import Throughout as Throughout
from .problem.constraint import AtNodes as AtNodes
from .problem.constraint import AcrossIntervals as AcrossIntervals
from .problem.bounds import bounds as bounds
from .problem.boundary import Boundary as Boundary
from .problem.boundary import fixed_state as fixed_state
from .problem.boundary import EndCondition as EndCondition
from .problem.boundary import EndRows as EndRows
from .problem.boundary import CoupledEnds as CoupledEnds
from .problem.boundary import periodic as periodic
from .problem.time import Time as Time
from .problem.time import FreeTime as FreeTime
from .problem.time import FixedTime as FixedTime
from .problem.problem import OptimalControlProblem as OptimalControlProblem
from .core.errors import InvalidProblem as InvalidProblem

# --- a guess ---
from .problem.trajectory import Trajectory as Trajectory
from .problem.guess import straight_line as straight_line

# --- a landing: vehicle, ends, corridor, limits, zones ---
from .dynamics import airframes as airframes
from .landing.mission import BodyState as BodyState
from .landing.mission import at_rest as at_rest
from .landing.mission import Components as Components
from .landing.mission import fixed as fixed
from . import corridor as corridor
from .landing.mission import FlightLimits as FlightLimits
from .landing.mission import flight_limits as flight_limits
from .landing.mission import Ellipsoids as Ellipsoids
from .landing.mission import ellipsoids as ellipsoids
from .landing.mission import Weights as Weights
from .landing.scenario import LandingScenario as LandingScenario
from .landing import scenarios as scenarios
from .landing.validation import validate as validate
from .core.errors import InvalidScenario as InvalidScenario

# --- a method ---
from .scp.newton import NewtonSCP as NewtonSCP
from .scp.ptr import PTR as PTR
from .scp.nodal_subproblem import NormTrustRegion as NormTrustRegion
from .scp.nodal_subproblem import ProximalTrustRegion as ProximalTrustRegion
from . import conic as conic
from .problem.scale import Scale as Scale

# --- solve ---
from .solver.solver import solve as solve
from .solver.solver import Solver as Solver
from .solver.planner import Planner as Planner
from .solver.scenario import Scenario as Scenario

# --- a solution ---
from .solver.solution import Solution as Solution
from .problem.samples import Samples as Samples
from .problem.samples import FlightSamples as FlightSamples
from .core.status import Status as Status
from .core.status import status_names as status_names
from .verification.certificate import Certificate as Certificate
from .verification.certificate import certify as certify
from .solver.best import best as best
from .backends.serving import Backends as Backends
from .backends.serving import PerformanceWarning as PerformanceWarning
from . import plot as plot

# --- feedback ---
from . import control as control

# --- the world of a flight ---
from . import simulation as simulation

# --- many cases ---
from . import mission as mission
from . import monte_carlo as monte_carlo

# --- compile, store, load ---
from .backends.xla import compiler_options as compiler_options
from .aot.aot import CompiledPlanner as CompiledPlanner
from .solver.compiled import CompiledSolver as CompiledSolver
from .solver.load import load as load
from .aot.archive import InvalidExport as InvalidExport
from .aot.cache_folder import use_cache as use_cache
