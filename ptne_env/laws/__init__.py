"""The analytical laws: the paper's, the field's, engineering variants, oracles and reference policies.

All of them act through the interfaces that learned policies use.
"""

from ptne_env.laws.adaptive import Adaptive as Adaptive
from ptne_env.laws.base import Law as Law
from ptne_env.laws.grounded import AdaptiveGrounded as AdaptiveGrounded
from ptne_env.laws.grounded import Grounded as Grounded
from ptne_env.laws.oracles import CentralisedOracle as CentralisedOracle
from ptne_env.laws.static import CorollaryOne as CorollaryOne
from ptne_env.laws.static import FixedGain as FixedGain
from ptne_env.laws.static import Static as Static
from ptne_env.laws.trivial import RandomPolicy as RandomPolicy
from ptne_env.laws.trivial import ZeroInput as ZeroInput
