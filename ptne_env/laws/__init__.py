"""The paper's laws, those of the literature, the strong ones of this library, and reference policies.

All of them act through the interfaces that learned policies use. A file holds one law, or a law and its variants;
``base`` holds the base classes, ``sources`` and ``identification`` are what several laws are built from.
"""

from ptne_env.laws.adaptive import Adaptive as Adaptive
from ptne_env.laws.base import Law as Law
from ptne_env.laws.coded import Coded as Coded
from ptne_env.laws.fixed_time import FixedTime as FixedTime
from ptne_env.laws.grounded import AdaptiveGrounded as AdaptiveGrounded
from ptne_env.laws.grounded import Grounded as Grounded
from ptne_env.laws.projected_gradient import ProjectedGradient as ProjectedGradient
from ptne_env.laws.proximal import ProximalBestResponse as ProximalBestResponse
from ptne_env.laws.references import Oracle as Oracle
from ptne_env.laws.references import RandomPolicy as RandomPolicy
from ptne_env.laws.references import ZeroInput as ZeroInput
from ptne_env.laws.relay import Relay as Relay
from ptne_env.laws.routed import RoutedUnknown as RoutedUnknown
from ptne_env.laws.static import CorollaryOne as CorollaryOne
from ptne_env.laws.static import Static as Static
