# Imported when first used: see ``__init__.py``. In the order in which data flows.

# --- a study ---
from .study import Study as Study
from .parameters import Parameter as Parameter
from .parameters import Set as Set
from .parameters import Add as Add
from .parameters import Scale as Scale
from .distributions import Distribution as Distribution
from .distributions import Uniform as Uniform
from .distributions import LogUniform as LogUniform
from .distributions import Normal as Normal
from .distributions import Choice as Choice
from .distributions import SciPy as SciPy
from .sampling import Sampling as Sampling
from .sampling import Independent as Independent
from .sampling import LatinHypercube as LatinHypercube
from .sampling import Sobol as Sobol
from .sampling import Grid as Grid
from .solves import Solves as Solves
from .outcome import Outcome as Outcome
from .errors import InvalidStudy as InvalidStudy

# --- what is stored ---
from .trajectories import Keep as Keep
from .trajectories import NoTrajectories as NoTrajectories
from .trajectories import AllTrajectories as AllTrajectories
from .trajectories import FailedTrajectories as FailedTrajectories
from .trajectories import EveryNth as EveryNth

# --- run ---
from .driver import sweep as sweep
from .driver import rerun as rerun
from .engines import Engine as Engine
from .engines import InProcess as InProcess
from .engines import Processes as Processes
from .engines import Workers as Workers
from .evaluators import OneByOne as OneByOne
from .evaluators import Together as Together
from .stopping import Stop as Stop
from .stopping import NarrowShare as NarrowShare
from .stopping import NarrowMean as NarrowMean
from .stopping import Budget as Budget
from .progress import Progress as Progress
from .progress import Snapshot as Snapshot
from .progress import Bar as Bar
from .progress import Lines as Lines
from .progress import JSONLines as JSONLines
from .progress import Silent as Silent
from .errors import SweepError as SweepError

# --- results ---
from .results import Sweep as Sweep
from .results import open_sweep as open_sweep
from .intervals import Interval as Interval
from .intervals import wilson as wilson
from .intervals import mean_interval as mean_interval
from .summary import Summary as Summary
from .summary import summarise as summarise
from .sensitivity import Effect as Effect
from .sensitivity import rank_correlations as rank_correlations
from .sensitivity import Saltelli as Saltelli
from .sensitivity import sobol_indices as sobol_indices
from .sensitivity import gradient as gradient
from .coverage import simulated_coverage as simulated_coverage
from .robustness import Robustness as Robustness
from .robustness import robustness as robustness

# --- pictures ---
from .pictures import draw_success_map as draw_success_map
from .pictures import draw_distributions as draw_distributions
from .pictures import draw_convergence as draw_convergence
from .pictures import draw_tornado as draw_tornado
from .pictures import draw_failures as draw_failures
from .report import write_report as write_report
from .robustness import draw_robustness as draw_robustness
