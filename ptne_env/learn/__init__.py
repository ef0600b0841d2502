"""Learned policies: small networks in ONNX files, run by onnxruntime without torch."""

from ptne_env.learn.learned import LearnedPolicy as LearnedPolicy
from ptne_env.learn.learned import Metadata as Metadata
from ptne_env.learn.learned import PolicyFileError as PolicyFileError
from ptne_env.learn.learned import load as load
from ptne_env.learn.learned import shipped as shipped
from ptne_env.learn.learned import shipped_path as shipped_path
