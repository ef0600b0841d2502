"""An archive as Stable-Baselines3 writes it, whose loading makes a file: the mark of code that ran."""

import base64
import json
import pickle
import zipfile
from pathlib import Path


class Payload:
    """An object whose unpickling makes the file ``mark``."""

    def __init__(self, mark):
        self.mark = Path(mark)

    def __reduce__(self):
        """The call that unpickling makes."""
        return Path.touch, (self.mark,)


def write_archive(path, mark):
    """Write an archive to ``path`` that makes the file ``mark`` when it is loaded."""
    pickled = base64.b64encode(pickle.dumps(Payload(mark))).decode()
    data = {"policy_class": {":type:": "<class 'abc.ABCMeta'>", ":serialized:": pickled}, "policy_kwargs": {}}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps(data))
        archive.writestr("_stable_baselines3_version", "2.7.0")
