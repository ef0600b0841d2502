"""Strong laws of the field: of the literature, and of this library."""

from ptne_env.field.laws.contact_relay import ContactRelay as ContactRelay
from ptne_env.field.laws.observer_relay import ObserverRelay as ObserverRelay
from ptne_env.field.laws.projected_gradient import ProjectedGradient as ProjectedGradient
from ptne_env.field.laws.proximal import ProximalBestResponse as ProximalBestResponse
from ptne_env.field.laws.residual_coder import ResidualCoder as ResidualCoder
from ptne_env.field.laws.routed import RoutedUnknown as RoutedUnknown
