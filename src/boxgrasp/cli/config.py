"""Print the configuration as it is resolved: every setting, defaults and file together, as YAML."""

from __future__ import annotations

import argparse

from boxgrasp.cli import _arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    _arguments.add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Print what a run with the same options would use."""
    from boxgrasp.config import config_hash, dump_config

    config = _arguments.resolve_config(args)
    print(f"# config_hash: {config_hash(config)}")
    print(dump_config(config), end="")
    return 0
