"""Pytest fixtures for tests with CARLA's client: a server for all tests, and a world for each test, which is recorded."""

from __future__ import annotations

import hashlib
import re
import shutil
import socket
import warnings
import weakref
from contextlib import ExitStack, suppress
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from pathlib import Path

    import carla

    from carla_recap.rules.rule_sets import RuleSet, Verdict

HOST: Final = "127.0.0.1"
FOLDER: Final = "carla-recordings"
TICK: Final = 0.05
"""The default time step, in s."""

_TIMEOUT: Final = 60.0  # s for a call
_TO_END: Final = 20.0  # s for the end of a recording after a test
_NAME: Final = 120  # characters of the name of a recording
_OPTIONS: Final = ("map", "rules", "fixed_delta_seconds", "synchronous")
_SECTION: Final = "carla-recap"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the command line."""
    group = parser.getgroup("carla-recap", "CARLA worlds and their recordings")
    group.addoption(
        "--carla-recap-dir",
        metavar="DIR",
        default=FOLDER,
        help="the folder of the recordings and pages of failed tests (default: %(default)s)",
    )
    group.addoption(
        "--carla-recap-release",
        metavar="RELEASE",
        default="auto",
        help="the release of CARLA that is served, such as 0.9.15 (default: that of the client)",
    )
    group.addoption("--carla-recap-rules", metavar="FILE", help="rules that the recording of every test must meet")
    group.addoption("--carla-recap-keep", choices=["failed", "all"], default="failed", help="whose recordings are kept")


def pytest_configure(config: pytest.Config) -> None:
    """Describe the marker, and refuse options that no test could be run with."""
    from carla_recap.errors import RecapError
    from carla_recap.util.text import single_line

    config.addinivalue_line(
        "markers",
        "carla(map, rules, fixed_delta_seconds, synchronous): the world of carla_world, and the rules for its recording",
    )
    there = next(each for each in _kept(config, "test")[0].parents if each.exists())
    try:
        if config.option.carla_recap_dir != FOLDER and not there.is_dir():  # else tests may not need it
            raise RecapError(f"--carla-recap-dir: {there}: is a file; a folder was expected")
        if config.option.carla_recap_release != "auto":
            from carla_recap.server.protocol import release_named

            release_named(config.option.carla_recap_release)
        if config.option.carla_recap_rules:
            from carla_recap.rules.rule_sets import load_rules

            load_rules(_rules(config))
    except RecapError as error:
        raise pytest.UsageError(single_line(error)) from None


class _Server:
    """A server process of a release of CARLA, as of `running`, started again if it has ended."""

    def __init__(self, folder: Path, release: str) -> None:
        self._folder = folder
        self._release = release
        self._stack = ExitStack()
        self._patch = pytest.MonkeyPatch()
        self._ends: list[Callable[[], object]] = []
        self._note_callbacks()
        self.port = 0
        self.start()

    def start(self) -> None:
        """Start the process, after the end of an earlier one, whose port it takes."""
        from carla_recap.server import running

        self._stack.close()
        server = running(recordings=self._folder, port=self.port, carla=self._release)
        self.port = self._stack.enter_context(server)

    @property
    def is_alive(self) -> bool:
        """Whether it accepts connections."""
        with suppress(OSError), socket.create_connection((HOST, self.port), _TIMEOUT):
            return True
        return False

    def _note_callbacks(self) -> None:
        """Note what sensors and worlds of the client are given to call."""
        import carla

        listen, on_tick = carla.Sensor.listen, carla.World.on_tick

        def noted_listen(sensor: carla.Sensor, callback: Callable[[Any], object]) -> None:
            listen(sensor, callback)
            kept = weakref.ref(sensor)
            self._ends.append(lambda: _stop(kept()))

        def noted_on_tick(world: carla.World, callback: Callable[[Any], object]) -> int:
            number: int = on_tick(world, callback)
            self._ends.append(lambda: world.remove_on_tick(number))
            return number

        self._patch.setattr(carla.Sensor, "listen", noted_listen)
        self._patch.setattr(carla.World, "on_tick", noted_on_tick)

    def end_callbacks(self) -> None:
        """End the callbacks of the client: one that outlives the interpreter aborts the process."""
        while self._ends:
            with suppress(RuntimeError):
                self._ends.pop()()

    def close(self) -> None:
        """End the callbacks and the process."""
        self.end_callbacks()
        self._patch.undo()
        self._stack.close()


def _stop(sensor: carla.Sensor | None) -> None:
    if sensor is not None and sensor.is_listening:
        sensor.stop()


class CarlaWorld:
    """The world of a test: a new episode of a map, without actors, in which time begins anew.

    Attributes:
        client: CARLA's client.
        recording: The path of the recording of the test; it is complete after `stop_recording`.
        broken: The verdicts of the rules that it has been found to break.
    """

    def __init__(self, server: _Server, recording: Path, options: dict[str, Any]) -> None:
        import carla

        from carla_recap.sim.town.loading import BUILT_IN

        self.recording = recording
        self.broken: list[Verdict] = []
        self._server = server
        self._step: float = options.get("fixed_delta_seconds", TICK)
        self._is_synchronous: bool = options.get("synchronous", True)
        self._is_recording = False
        if not server.is_alive:  # it has ended during the last test
            server.start()
        self.client = carla.Client(HOST, server.port)
        self.client.set_timeout(_TIMEOUT)
        self.load_world(options.get("map") or BUILT_IN)

    @cached_property
    def world(self) -> carla.World:
        """CARLA's world."""
        return self.client.get_world()

    @cached_property
    def traffic_manager(self) -> carla.TrafficManager:
        """A traffic manager of this test alone, synchronous if the world is."""
        manager = self.client.get_trafficmanager(_free_port())
        manager.set_synchronous_mode(self._is_synchronous)
        if self._is_synchronous:
            # Its first cycle is asynchronous: it forgets each vehicle registered that was spawned since the last tick.
            # Settings are signalled to managers as ticks are: this returns when the manager waits for the next signal.
            self.world.apply_settings(self.world.get_settings())
        return manager

    def load_world(self, name: str) -> carla.World:
        """Begin a new episode of a map; the recording begins anew.

        Args:
            name: The name of the map.
        """
        import carla

        self.stop_recording()
        # An episode in asynchronous mode would tick by the clock until its settings are applied.
        self.client.get_world().apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=self._step))
        self.world = self.client.load_world(name, False)
        if not self._is_synchronous:
            self.world.apply_settings(carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=self._step))
        self.world.reset_all_traffic_lights()
        self.client.start_recorder(str(self.recording), True)
        self._is_recording = True
        return self.world

    def tick(self, seconds: float = 0.0) -> int:
        """Let time pass in a synchronous world; return the number of the last frame.

        Args:
            seconds: The simulated seconds, at least one time step.
        """
        for _ in range(round(seconds / self._step) - 1):
            self.world.tick()
        return int(self.world.tick())

    def stop_recording(self) -> Path:
        """Complete the recording; what follows is not recorded. Return its path."""
        if self._is_recording:
            self._is_recording = False
            if not self._server.is_alive:  # whose answer would be waited for
                raise RuntimeError("the server has ended")
            self.client.stop_recorder()
            self.client.get_server_version()  # which is answered when the recording is complete
        return self.recording

    def assert_rules(self, rules: RuleSet | Path | str | None = None, /, **conditions: Any) -> None:
        """Complete the recording, and assert that it meets rules.

        Args:
            rules: The rules, or their file.
            conditions: Conditions by name, such as `collisions={"of": "hero", "max": 0}`.

        Raises:
            AssertionError: It does not; the message has the verdicts.
        """
        __tracebackhide__ = True
        from carla_recap.recording import open_recording
        from carla_recap.rules.rule_sets import RuleSet, check, load_rules, make_rules

        demanded = [make_rules(**conditions)] if conditions else []
        if rules is not None:
            demanded.insert(0, rules if isinstance(rules, RuleSet) else load_rules(rules))
        with open_recording(self.stop_recording()) as recording:
            verdicts = check(recording, [rule for each in demanded for rule in each])
        broken = [verdict for verdict in verdicts if verdict.status != "pass"]
        self.broken += broken
        if broken:
            lines = [f"{verdict.rule}: {verdict.message}" for verdict in broken]
            raise AssertionError("\n".join((f"{len(broken)} of {len(verdicts)} rules are broken", *lines)))

    def close(self) -> None:
        """End callbacks and the traffic manager, and complete the recording; the server may have ended."""
        self._server.end_callbacks()
        self.client.set_timeout(_TO_END)
        with suppress(RuntimeError):
            self.stop_recording()
        if "traffic_manager" in vars(self):
            with suppress(RuntimeError):
                self.traffic_manager.shut_down()


_WORLD: Final = pytest.StashKey[CarlaWorld]()


@pytest.fixture(scope="session")
def _carla_recap_server(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Iterator[_Server]:
    server = _Server(tmp_path_factory.mktemp("recordings"), pytestconfig.getoption("--carla-recap-release"))
    yield server
    server.close()


@pytest.fixture(scope="session")
def carla_server(_carla_recap_server: _Server) -> int:
    """Return the port of a server with the built-in town, for `carla.Client("localhost", port)`; one for all tests."""
    return _carla_recap_server.port


@pytest.fixture
def carla_world(
    request: pytest.FixtureRequest, _carla_recap_server: _Server, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[CarlaWorld]:
    """Yield a world for this test alone, in synchronous mode, without actors, whose recording is kept if the test fails."""
    marker = request.node.get_closest_marker("carla")
    options = dict(marker.kwargs) if marker else {}
    unknown = [name for name in options if name not in _OPTIONS]
    if unknown or (marker and marker.args):
        pytest.fail(f"the marker carla takes {', '.join(f'{name}=' for name in _OPTIONS)} alone", pytrace=False)
    name = _file_name(request.node.nodeid)
    for old in _kept(request.config, name):
        old.unlink(missing_ok=True)
    world = CarlaWorld(_carla_recap_server, tmp_path_factory.mktemp("carla") / f"{name}.mcap", options)
    request.node.stash[_WORLD] = world
    yield world
    world.close()
    shutil.rmtree(world.recording.parent, ignore_errors=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Any, Any]:
    """Check the recording after a test by the rules of the marker and of the command line."""
    result = yield
    world = item.stash.get(_WORLD, None)
    if world is not None:
        marker = item.get_closest_marker("carla")
        files = [item.path.parent / marker.kwargs["rules"]] if marker and marker.kwargs.get("rules") else []
        if item.config.option.carla_recap_rules:
            files.append(_rules(item.config))
        try:
            for file in files:
                world.assert_rules(file)
        except AssertionError as error:
            raise pytest.fail.Exception(str(error), pytrace=False) from None
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Generator[None, Any, Any]:
    """Keep the recording and the page of a failed test, and name them in its report."""
    report: pytest.TestReport = yield
    world = item.stash.get(_WORLD, None)
    keeps_all = item.config.option.carla_recap_keep == "all" and report.when == "call"
    if world is not None and report.when != "teardown" and (report.failed or keeps_all):
        lines = _keep(world, item.config, _file_name(item.nodeid), page=report.failed)
        report.sections.append((_SECTION, "\n".join(lines)))
    return report


def _keep(world: CarlaWorld, config: pytest.Config, name: str, *, page: bool) -> list[str]:
    """Move the recording of a test, and write its page; return what to say of them."""
    from carla_recap.errors import RecapError
    from carla_recap.fleet.pages import opening_of
    from carla_recap.recording import open_recording
    from carla_recap.show.page import write_report
    from carla_recap.town.mesh import load_town_of
    from carla_recap.util.files import make_folder

    kept, kept_page = _kept(config, name)
    lines = []
    try:
        world.stop_recording()
        make_folder(kept.parent)
        shutil.copyfile(world.recording, kept)
        lines.append(f"recording: {kept}")
        if page:
            with warnings.catch_warnings(), open_recording(kept) as recording:
                warnings.simplefilter("ignore")
                opening, town = opening_of(world.broken), load_town_of(recording)
                write_report(recording, kept_page, opening=opening, town=town, force=True)
            lines.append(f"page: {kept_page}")
    except (RecapError, RuntimeError, OSError) as error:
        lines.append(f"{'page' if lines else 'recording'}: none: {error}")
    return lines


def _rules(config: pytest.Config) -> Path:
    """Return the file of the rules for all tests."""
    file: Path = config.invocation_params.dir / config.option.carla_recap_rules
    return file


def _kept(config: pytest.Config, name: str) -> tuple[Path, Path]:
    """Return the paths of the recording and of the page of a test that has failed."""
    folder = config.invocation_params.dir / config.option.carla_recap_dir
    return folder / f"{name}.mcap", folder / f"{name}.html"


def _file_name(nodeid: str) -> str:
    """Return a name for the files of a test: that of the test, and of its module; no two tests have the same."""
    path, _, test = nodeid.partition("::")
    name = re.sub(r"[^\w.-]+", "-", f"{path.removesuffix('.py')}-{test}").strip("-.")
    is_plain = "-" not in path and re.fullmatch(r"[\w.-]+(\[[\w.-]+\])?", test.replace("::", "-"))
    if len(name) <= _NAME and is_plain:
        return name
    return f"{name[:_NAME]}-{hashlib.sha256(nodeid.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def _free_port() -> int:
    with socket.socket() as listening:
        listening.bind((HOST, 0))
        return int(listening.getsockname()[1])
