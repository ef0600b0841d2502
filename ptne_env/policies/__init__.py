"""Learned policies: small networks in ONNX files, run by onnxruntime without torch."""

from ptne_env.policies.learned import LearnedPolicy as LearnedPolicy
from ptne_env.policies.learned import SizeFreeFile as SizeFreeFile
from ptne_env.policies.learned import load as load
from ptne_env.policies.learned import shipped as shipped
from ptne_env.policies.learned import shipped_path as shipped_path
from ptne_env.policies.metadata import Metadata as Metadata
from ptne_env.policies.metadata import PolicyFileError as PolicyFileError
from ptne_env.policies.metadata import PolicyLayoutError as PolicyLayoutError
from ptne_env.policies.metadata import SizeFreeMetadata as SizeFreeMetadata
from ptne_env.policies.size_free import SizeFreePolicy as SizeFreePolicy
