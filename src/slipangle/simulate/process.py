"""`PlantProcess`: a vehicle in another process, over a local socket, in lines of JSON that any language can write.

One connection, TCP on this machine only (127.0.0.1 or ::1), UTF-8, one JSON object a line, at most 64 kB. The toolbox
asks, the vehicle answers each line with one line:

=============================================================  =======================================================
asked                                                          answered
=============================================================  =======================================================
``{"hello": 1}``                                               ``{"dt": 0.01, "inputs": ["delta"], "outputs": ["X"]}``
``{"reset": {"X": 0.0, "Y": 0.0, "psi": 0.0, "v_x": 20.0}}``   ``{"measured": {"X": 0.0}}``, every output
``{"step": {"delta": 0.02}}``                                  ``{"measured": {"X": 0.2}}``
=============================================================  =======================================================

What they mean says `slipangle.simulate.foreign.PlantProtocol`. A channel that is null or left out of the answer to a
step is missing; ``{"error": "a sentence"}`` may answer anything and ends the drive with that sentence. The connection
ends when the toolbox closes it. `serve` is the other side for a vehicle in Python.
"""

from __future__ import annotations

import ipaddress
import json
import math
import socket
from collections.abc import Callable, Mapping
from typing import Any

from slipangle.errors import ConfigError, FormatError, ParameterError, SimulationError, shown
from slipangle.shown import Brief
from slipangle.simulate.foreign import Channels, PlantProtocol, require_plant

VERSION = 1
LONGEST = 65_536  # bytes of a line
PATIENCE = 10.0  # s for an answer


def local_address(text: str) -> tuple[str, int]:
    """Host and port of ``"127.0.0.1:5005"``, on this machine.

    Raises ConfigError if it is not written so, or names another machine.
    """
    host, colon, port = text.rpartition(":")
    host = host.strip("[]")
    if not (colon and port.isdecimal() and 0 < int(port) < 65536):
        raise ConfigError(f'the address is {shown(text)}; expected a host and a port: write "127.0.0.1:5005"')
    host = "127.0.0.1" if host in ("", "localhost") else host
    try:
        near = ipaddress.ip_address(host).is_loopback
    except ValueError:
        near = False
    if not near:
        raise ConfigError(f"the address is {shown(text)}; expected one of this machine: use 127.0.0.1 or ::1")
    return host, int(port)


class PlantProcess(Brief):
    """A `PlantProtocol` behind a local socket.

    Raises ConfigError if the address is not one of this machine or nobody answers there, FormatError if an answer is
    not of the protocol, SimulationError if the vehicle reports an error or goes away, ParameterError if
    the patience is not positive.

    Parameters
    ----------
    address : str
        Where it listens, such as ``"127.0.0.1:5005"``.
    patience : float
        How long to wait for an answer. [s]
    """

    _lists = ("address", "inputs", "outputs", "dt")

    def __init__(self, address: str, *, patience: float = PATIENCE) -> None:
        if not 0 < patience < math.inf:
            raise ParameterError(f"patience is {patience} s; expected a positive time")
        place, self.address = local_address(address), address
        try:
            self._socket = socket.create_connection(place, timeout=patience)
        except OSError as error:
            raise ConfigError(
                f"no plant answers at {shown(address)} ({error.strerror or error}); expected one that listens: start "
                "it first"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._patience, self._rest = patience, b""
        try:
            self._greet()
        except Exception:
            self.close()
            raise

    def _greet(self) -> None:
        said = self._ask({"hello": VERSION})
        inputs, outputs = said.get("inputs"), said.get("outputs")
        if not (isinstance(inputs, list) and isinstance(outputs, list)):
            raise FormatError(
                f"the plant at {self.address} answers hello with {shown(said)}; expected dt, inputs, outputs"
            )
        self.dt: Any = said.get("dt")
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        require_plant(self)

    def reset(self, start: Channels) -> Channels:
        """See `PlantProtocol.reset`."""
        return self._measured({"reset": dict(start)})

    def step(self, commands: Channels) -> Channels:
        """See `PlantProtocol.step`."""
        return self._measured({"step": dict(commands)})

    def close(self) -> None:
        """End the connection."""
        self._socket.close()

    def __enter__(self) -> PlantProcess:
        return self

    def __exit__(self, *ended: object) -> None:
        self.close()

    def _measured(self, question: Mapping[str, Any]) -> Channels:
        answer = self._ask(question)
        if not isinstance(answer.get("measured"), dict):
            raise FormatError(
                f'the plant at {self.address} answers {next(iter(question))} with {shown(answer)}; expected "measured"'
            )
        return answer["measured"]

    def _ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        try:
            self._socket.sendall(json.dumps(question).encode() + b"\n")
            line = self._line()
        except TimeoutError:
            raise SimulationError(
                f"the plant at {self.address} did not answer within {self._patience:g} s; expected a line: give it "
                "more patience"
            ) from None
        except OSError as error:
            raise SimulationError(f"the plant at {self.address} went away ({error.strerror or error})") from None
        return _parsed(line, f"the plant at {self.address}")

    def _line(self) -> bytes:
        while b"\n" not in self._rest:
            if len(self._rest) > LONGEST:
                raise FormatError(f"the plant at {self.address} sends a line of more than {LONGEST} bytes")
            more = self._socket.recv(LONGEST)
            if not more:
                raise OSError("it closed the connection")
            self._rest += more
        line, _, self._rest = self._rest.partition(b"\n")
        return line


def _parsed(line: bytes, who: str) -> dict[str, Any]:
    """A line of JSON that is an object.

    Raises FormatError if it is not, SimulationError if it reports an error.
    """
    try:
        said = json.loads(line)
    except (ValueError, RecursionError):
        said = None
    if not isinstance(said, dict):
        raise FormatError(f"{who} sends {shown(line[:80])}; expected one JSON object a line")
    if "error" in said:
        raise SimulationError(f"{who} says: {str(said['error'])[:200]}")
    return said


def serve(
    plant: PlantProtocol, port: int = 0, *, ready: Callable[[str], None] | None = None, patience: float = 60.0
) -> None:
    """Let one toolbox drive a vehicle over a local socket, until it closes the connection.

    Raises ParameterError if the vehicle lacks something, ConfigError if nobody connects.

    Parameters
    ----------
    plant : PlantProtocol
        The vehicle.
    port : int
        Where to listen on 127.0.0.1; 0 takes a free one.
    ready : callable, optional
        Told the address once it listens, such as ``"127.0.0.1:5005"``; by default it is printed.
    patience : float
        How long to wait for somebody to connect. [s]
    """
    require_plant(plant)
    with socket.create_server(("127.0.0.1", port)) as listening:
        listening.settimeout(patience)
        (ready or (lambda address: print(address, flush=True)))("{}:{}".format(*listening.getsockname()[:2]))
        try:
            connection, _ = listening.accept()
        except TimeoutError:
            raise ConfigError(f"nobody connected within {patience:g} s; expected a PlantProcess") from None
    with connection:
        connection.settimeout(None)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection.makefile("rb") as lines:
            while line := lines.readline(LONGEST):
                connection.sendall(_answer(plant, line) + b"\n")


def _answer(plant: PlantProtocol, line: bytes) -> bytes:
    """What the vehicle says to a line; an error in place of an exception, which the other side raises."""
    try:
        asked = _parsed(line, "the toolbox")
        if "hello" in asked:
            if asked["hello"] != VERSION:
                raise FormatError(f"the protocol's version is {shown(asked['hello'])}; expected {VERSION}")
            said: dict[str, Any] = {"dt": plant.dt, "inputs": list(plant.inputs), "outputs": list(plant.outputs)}
        else:
            what = next((n for n in ("reset", "step") if n in asked), None)
            if what is None or not isinstance(asked[what], dict):
                raise FormatError(f"the toolbox asks {shown(asked)}; expected hello, reset or step")
            measured = getattr(plant, what)(asked[what])
            said = {"measured": {n: _number(measured.get(n)) for n in plant.outputs}}
    except Exception as error:  # it is told to the other side, which raises it
        said = {"error": f"{type(error).__name__}: {str(error)[:200]}"}
    return json.dumps(said).encode()


def _number(value: Any) -> float | None:
    """A measurement as JSON has it: null where it is missing; infinity stays what it is."""
    number = math.nan if value is None else float(value)
    return None if math.isnan(number) else number
