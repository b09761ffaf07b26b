"""What the base install leaves out: parts that one job needs come as extras, asked for by name when it is done."""

import importlib
from typing import Any

from slipangle.errors import MissingExtraError


def extra(module: str, bundle: str, job: str) -> Any:
    """A module that an extra of pyproject.toml brings, such as ``"neural"``; ``job`` is what needs it.

    Raises MissingExtraError if it is not installed; the sentence says what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtraError(
            f"{job} needs {module}, which is not installed; expected the extra: pip install 'slipangle[{bundle}]'"
        ) from None
