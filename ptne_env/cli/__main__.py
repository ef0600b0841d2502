"""``python -m ptne_env.cli``."""

from ptne_env.cli import main

if __name__ == "__main__":
    main()
