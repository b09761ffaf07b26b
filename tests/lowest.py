"""The lowest versions that pyproject.toml allows, as pip's constraints: ``python -m tests.lowest``."""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(\[[\w,.-]+\])?(?P<kind>>=|==)(?P<version>[\d.]+)")


def requirements() -> dict[str, list[str]]:
    """What is installed with the package, with its extras, and for its tests; by group."""
    table = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    project, groups = table["project"], table["dependency-groups"]
    return {"core": project["dependencies"], **project["optional-dependencies"], "test": groups["test"]}


def constraints() -> list[str]:
    """One ``name==version`` per requirement."""
    lines = []
    for group, members in requirements().items():
        for member in members:
            found = REQUIREMENT.fullmatch(member)
            if found is None:
                raise SystemExit(f"'{member}' of {group} names no lowest version; expected name>=version")
            lines.append(f"{found['name']}=={found['version']}")
    return lines


if __name__ == "__main__":
    print("\n".join(constraints()))
