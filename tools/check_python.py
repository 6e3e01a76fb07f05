"""Say in one line what the machine lacks before the environment is made."""

import sys


def missing() -> str | None:
    """What is missing to set up the project, or None."""
    if not (3, 10) <= sys.version_info[:2] < (3, 15):
        found = f"{sys.version_info[0]}.{sys.version_info[1]}"
        return f"Python {found} found; boxgrasp needs 3.10 to 3.14 (make PYTHON=python3.12)"
    for module, package in (("venv", "python3-venv"), ("pip", "python3-pip")):
        try:
            __import__(module)
        except ImportError:
            return f"{sys.executable} has no module {module}; apt-get install {package}"
    return None


if __name__ == "__main__":
    if problem := missing():
        sys.exit(f"boxgrasp: {problem}")
