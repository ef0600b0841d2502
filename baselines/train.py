"""Train one policy: ``python baselines/train.py random-energy --out runs/random-energy --seed 0``.

The same as ``ptne train``. What it does is one file, ``ptne_env/learn/training/ppo.py``, with the configurations beside it.
"""

import sys

from ptne_env.cli import main

if __name__ == "__main__":
    sys.argv.insert(1, "train")
    main()
