"""The analytical laws: the paper's, the field's, engineering variants, oracles and reference policies.

All of them act through the interfaces that learned policies use.
"""

from ptne_env.laws.adaptive import Adaptive as Adaptive
from ptne_env.laws.adaptive import AveragingIntegral as AveragingIntegral
from ptne_env.laws.base import Law as Law
from ptne_env.laws.broadcast import IdentifyAndBroadcast as IdentifyAndBroadcast
from ptne_env.laws.broadcast import LinkBroadcast as LinkBroadcast
from ptne_env.laws.discrete import AggregateTracking as AggregateTracking
from ptne_env.laws.discrete import ProjectedGradient as ProjectedGradient
from ptne_env.laws.extremum_seeking import ExtremumSeeking as ExtremumSeeking
from ptne_env.laws.gated import ObserverRelay as ObserverRelay
from ptne_env.laws.grounded import AdaptiveGrounded as AdaptiveGrounded
from ptne_env.laws.grounded import Grounded as Grounded
from ptne_env.laws.multi_rate import MultiRate as MultiRate
from ptne_env.laws.oracles import BestResponseOracle as BestResponseOracle
from ptne_env.laws.oracles import CentralisedOracle as CentralisedOracle
from ptne_env.laws.oracles import FixedTimeOracle as FixedTimeOracle
from ptne_env.laws.oracles import NodeAdaptiveOracle as NodeAdaptiveOracle
from ptne_env.laws.proximal import ProximalBestResponse as ProximalBestResponse
from ptne_env.laws.relay import ContactRelay as ContactRelay
from ptne_env.laws.relay import FreshestRelay as FreshestRelay
from ptne_env.laws.relay import LinkRelay as LinkRelay
from ptne_env.laws.relay import Relay as Relay
from ptne_env.laws.relay import RouteRelay as RouteRelay
from ptne_env.laws.routed import Freshest as Freshest
from ptne_env.laws.routed import Routed as Routed
from ptne_env.laws.routed import RoutedUnknown as RoutedUnknown
from ptne_env.laws.static import CorollaryOne as CorollaryOne
from ptne_env.laws.static import FixedGain as FixedGain
from ptne_env.laws.static import Static as Static
from ptne_env.laws.trivial import RandomPolicy as RandomPolicy
from ptne_env.laws.trivial import ZeroInput as ZeroInput
from ptne_env.laws.variants import CappedGain as CappedGain
from ptne_env.laws.variants import LocallyImplicit as LocallyImplicit
