"""What theory predicts: assumptions, conditions of theorems, rates, digits and stable steps.

docs/theory.md says of each prediction whether it is exact or a bound, and where it comes from.
"""

from ptne_env.theory.assumptions import LemmaViolationError as LemmaViolationError
from ptne_env.theory.assumptions import check_assumptions as check_assumptions
from ptne_env.theory.assumptions import check_costs as check_costs
from ptne_env.theory.assumptions import check_time_transformation as check_time_transformation
from ptne_env.theory.certificate import Certificate as Certificate
from ptne_env.theory.certificate import build_law as build_law
from ptne_env.theory.certificate import certify as certify
from ptne_env.theory.closed_loop import closed_loop_matrix as closed_loop_matrix
from ptne_env.theory.closed_loop import decay_rate as decay_rate
from ptne_env.theory.closed_loop import gain_growth as gain_growth
from ptne_env.theory.closed_loop import largest_stable_step as largest_stable_step
from ptne_env.theory.closed_loop import law_matrix as law_matrix
from ptne_env.theory.closed_loop import sampled_loop as sampled_loop
from ptne_env.theory.closed_loop import spectral_abscissa as spectral_abscissa
from ptne_env.theory.conditions import CONDITIONS as CONDITIONS
from ptne_env.theory.conditions import Condition as Condition
from ptne_env.theory.conditions import condition as condition
from ptne_env.theory.conditions import coupling_radius as coupling_radius
from ptne_env.theory.constants import MonotonicityConstants as MonotonicityConstants
from ptne_env.theory.constants import ProblemConstants as ProblemConstants
from ptne_env.theory.constants import gain_bound as gain_bound
from ptne_env.theory.constants import monotonicity_constants as monotonicity_constants
from ptne_env.theory.constants import problem_constants as problem_constants
