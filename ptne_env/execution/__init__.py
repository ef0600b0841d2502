"""Long work: many jobs on cores or machines, what is done is not run again, and results are checked.

- ``runner``, ``workers``: jobs on cores or machines; ``store``: their results in a folder
- ``result_files``, ``verification``: results of a comparison in a file, and whether they can be believed
"""

from ptne_env.execution.runner import Runner as Runner
from ptne_env.execution.workers import Workers as Workers
