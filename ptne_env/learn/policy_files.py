"""Files of policies: their formats, those that ship, and the loader of the formats that are data."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from glob import escape, glob
from pathlib import Path
from typing import Any, NamedTuple

from ptne_env.learn.layers import LayeredPolicy
from ptne_env.learn.npz_policy import open_policy
from ptne_env.learn.recurrent import RecurrentPolicy
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.files import read_file
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import FactorySpec

TRACK = "{track}"
"""What stands for the name of the track in the name or path of a policy that has one file per track."""


class PolicyFormat(NamedTuple):
    """A format of policy files.

    Attributes:
        endings: the endings of the files' names.
        target: the function that loads a file, as :class:`FactorySpec` names it.
        argument: the name of the argument of that function that takes the file.
        libraries: the libraries that the policies compute with, beside those that every result depends on.
        executes_code: whether loading a file executes code that is stored in it.
    """

    endings: tuple[str, ...]
    target: str
    argument: str
    libraries: tuple[str, ...]
    executes_code: bool

    def spec(self, path_or_name: str) -> FactorySpec:
        """Return the factory spec of the policy in a file of this format."""
        return FactorySpec.of(self.target, **{self.argument: path_or_name})


DATA = PolicyFormat((".npz",), "policy:file", "path_or_name", (), executes_code=False)
ARCHIVE = PolicyFormat(
    (".zip",), "ptne_env.learn.sb3_archive:load_archive", "path", ("stable_baselines3", "torch"), executes_code=True
)
FORMATS = (DATA, ARCHIVE)
"""The formats of policy files. An archive is no part of the library, because it may execute any code."""


def format_of(source: Any) -> PolicyFormat | None:
    """Return the format of the file that a factory spec loads; ``None`` if it loads none, or is no factory spec."""
    targets = {each.target: each for each in FORMATS}
    return targets.get(source.target) if isinstance(source, FactorySpec) else None


@cache
def _shipped_files() -> Mapping[str, Path]:
    """Return the policy files of the library by their names without endings, in order."""
    paths = {path.stem: path for path in Path(__file__).parent.iterdir() if path.suffix in DATA.endings}
    return dict(sorted(paths.items()))


def shipped_names() -> list[str]:
    """Return the names of the policies in the library."""
    return list(_shipped_files())


def shipped_path(name: str) -> Path:
    """Return the file of a policy in the library; ``ValueError`` for another name."""
    shipped = _shipped_files()
    return shipped[require_name("learned policy", name, shipped, "an .npz file")]


def find_file(path_or_name: str | Path) -> Path:
    """Return the path of a policy file, which may be given by the name of a policy in the library."""
    return shipped_path(str(path_or_name)) if str(path_or_name) in shipped_names() else Path(path_or_name)


def files_by_track(path_or_name: str) -> dict[str, str]:
    """Return the paths or names of the files of a policy that has one file per track, by track."""
    start, _, end = path_or_name.partition(TRACK)
    names = [*shipped_names(), *glob(f"{escape(start)}*{escape(end)}")]  # noqa: PTH207 - it may be absolute
    fitting = sorted(name for name in names if name.startswith(start) and name.endswith(end))
    return {name.removeprefix(start).removesuffix(end): name for name in fitting}


def load(path_or_name: str | Path, layout: ObservationLayout | None = None) -> RecurrentPolicy | LayeredPolicy:
    """Load a learned policy from an ``.npz`` file, or a policy of the library by name.

    Args:
        path_or_name: the path of the file, or the name of a shipped policy.
        layout: the layout of the environment in which the policy must be able to act; not checked if left out. A
            recurrent policy for worlds of any size needs it before it acts.

    Raises:
        ValueError: for an unknown name.
        FileNotFoundError: when there is no such file.
        DamagedFileError: when the file is too large or no regular file.
        PolicyFileError: when the file is damaged, foreign or of another version.
        LayoutError: when the policy was made for another layout.
        TypeError: for a layout that is none, such as an environment.
    """
    if not isinstance(layout, ObservationLayout | None):
        raise TypeError(f"a policy is loaded for a layout, such as env.layout, got a {type(layout).__name__}")
    path = find_file(path_or_name)
    if path.suffix not in DATA.endings:
        path = shipped_path(str(path_or_name))  # which says what there is
    policy = open_policy(path, read_file(path))
    return policy if layout is None else policy.with_layout(layout)
