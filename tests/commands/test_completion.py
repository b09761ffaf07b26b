"""The Tab key: bash is asked what it would offer, with the script that the toolbox prints."""

import shutil
import subprocess

import pytest

from slipangle.cli import main
from slipangle.workflow.reference import tables

zsh = pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh to ask")
bash = pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash to ask")


def offered(script: str, line: str) -> list[str]:
    """What bash offers for the last word of a line."""
    words = " ".join(f"'{w}'" for w in line.split(" "))
    ask = (
        f'COMP_WORDS=({words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); _slipangle; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    done = subprocess.run(["bash", "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True, timeout=20)
    assert not done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def script():
    from contextlib import redirect_stdout
    from io import StringIO

    out = StringIO()
    with redirect_stdout(out):
        assert main(["completion", "bash"]) == 0
    return out.getvalue()


@bash
@pytest.mark.parametrize(
    ("line", "some", "others"),
    [
        ("slipangle ", {"run", "identify", "data", "help"}, {"get", "--out"}),
        ("slipangle id", {"identify"}, {"inspect"}),
        ("slipangle data ", {"get", "list", "check"}, {"run"}),
        ("slipangle run --q", {"--quiet"}, {"--json"}),
        ("slipangle run jo", set(), {"job"}),
        ("slipangle init --kind ", {"car", "bicycle"}, {"--kind"}),
        ("slipangle init ", set(), {"car"}),
        ("slipangle list pl", {"plants"}, {"models"}),
        ("slipangle help job model.st", {"model.state-space"}, {"model.arx"}),
        ("slipangle completion ", {"bash", "zsh"}, set()),
    ],
)
def test_what_is_offered(script, line, some, others):
    found = set(offered(script, line))
    assert some <= found
    assert not others & found
    assert found or not some


@bash
def test_every_table_is_offered(script):
    assert set(offered(script, "slipangle help job ")) >= set(tables())


def test_the_script_for_zsh_is_the_same_behind_its_adapter(script, capsys):
    assert main(["completion", "zsh"]) == 0
    said = capsys.readouterr().out
    assert said.endswith(script)
    assert "bashcompinit" in said.removesuffix(script)


@zsh
def test_zsh_takes_its_script_and_knows_the_command(capsys):
    """As in a .zshrc: the script is read, and the command is then completed by its function."""
    assert main(["completion", "zsh"]) == 0
    ask = f'{capsys.readouterr().out}\nprint -r -- "$_comps[slipangle]"'
    done = subprocess.run(["zsh", "-f", "-c", ask], capture_output=True, text=True, check=True, timeout=20)
    assert not done.stderr
    assert "_slipangle" in done.stdout
