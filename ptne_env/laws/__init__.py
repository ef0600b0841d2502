"""The paper's laws, a few of the literature, and reference policies; the strong ones are in ``ptne_env.field.laws``.

All of them act through the interfaces that learned policies use.
"""

from ptne_env.laws.adaptive import Adaptive as Adaptive
from ptne_env.laws.base import Law as Law
from ptne_env.laws.grounded import AdaptiveGrounded as AdaptiveGrounded
from ptne_env.laws.grounded import Grounded as Grounded
from ptne_env.laws.static import CorollaryOne as CorollaryOne
from ptne_env.laws.static import Static as Static
from ptne_env.laws.trivial import Oracle as Oracle
from ptne_env.laws.trivial import RandomPolicy as RandomPolicy
from ptne_env.laws.trivial import ZeroInput as ZeroInput
