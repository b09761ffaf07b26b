"""What the base install leaves out: parts that one job needs come as extras, asked for by name when it is done."""

from __future__ import annotations

import importlib
from typing import Any

from slipangle.errors import ConfigError


def extra(module: str, bundle: str, job: str) -> Any:
    """A module that an extra brings.

    Parameters
    ----------
    module : str
        Its name.
    bundle : str
        The extra's name in pyproject.toml, such as ``"neural"``.
    job : str
        What needs it, as the subject of a sentence.

    Raises
    ------
    ConfigError
        If it is not installed; the sentence says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ConfigError(
            f"{job} needs {module}, which is not installed; expected the extra: pip install 'slipangle[{bundle}]'"
        ) from None
