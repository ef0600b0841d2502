"""The analytical laws: the paper's, the field's, and anchors. They act through the interface of any learned policy."""

from ptne_env.laws.adaptive import Adaptive as Adaptive
from ptne_env.laws.anchors import CentralisedOracle as CentralisedOracle
from ptne_env.laws.anchors import Null as Null
from ptne_env.laws.anchors import RandomPolicy as RandomPolicy
from ptne_env.laws.base import Law as Law
from ptne_env.laws.grounded import Grounded as Grounded
from ptne_env.laws.static import CorollaryOne as CorollaryOne
from ptne_env.laws.static import Static as Static
