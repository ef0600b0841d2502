"""Shared by all tests: one thread per process, counts of random cases, values built once, an offline browser."""

import os
import pickle
import shutil

# Every test process would start a thread pool as large as the machine. NumPy and torch read these variables when they
# are imported, so they are set first; subprocesses inherit them.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest
from hypothesis import settings

settings.register_profile("fast", derandomize=True, deadline=None, max_examples=25)
settings.register_profile("soak", deadline=None, max_examples=1000)
settings.load_profile("soak" if os.environ.get("PTNE_SOAK") else "fast")


QUIET = ("--disable-gpu", "--disable-quic", "--disable-background-networking", "--disable-component-update")


@pytest.fixture(scope="session")
def build_once(tmp_path_factory):
    """``build_once(name, build)`` returns ``build()``, called in the first test process and pickled for the others."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # the folder of each process lies in that of the run
        folder = folder.parent

    def value_of(name, build):
        from filelock import FileLock

        file = folder / f"{name}.pickle"
        with FileLock(f"{file}.lock"):
            if not file.exists():
                file.write_bytes(pickle.dumps(build()))
            return pickle.loads(file.read_bytes())  # noqa: S301 - written by this run

    return value_of


@pytest.fixture(scope="module")
def browser():
    """The Chromium of the system."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install 'ptne-env[test]'")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("needs Chromium in the PATH: apt-get install chromium")
    arguments = [*QUIET, *(["--no-sandbox"] if os.geteuid() == 0 else [])]  # Chromium refuses a sandbox to root
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=program, args=arguments)
        yield running
        running.close()


@pytest.fixture
def open_file(browser):
    """Opens a file without a network; a console message, a failed request or a dialog fails the test."""
    contexts, complaints = [], []

    def open_page(path, width=1280, scheme="light"):
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True)
        context.set_default_timeout(60_000)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("requestfailed", lambda request: complaints.append(request.url))
        page.on("dialog", lambda dialog: (complaints.append(dialog.message), dialog.dismiss()))
        page.goto(path.as_uri())
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert complaints == []
