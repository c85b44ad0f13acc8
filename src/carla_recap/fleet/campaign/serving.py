"""A script for CARLA's client as a run: in a process of its own, against a server of its own in this process."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.server.host import Host
from carla_recap.server.protocol import release_named
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.serving import serve
from carla_recap.util.processes import environment_of_user

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.fleet.campaign import Campaign
    from carla_recap.fleet.campaign.plan import CampaignRun
    from carla_recap.server.host import Client
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.world import World

_ADDRESS: Final = "127.0.0.1"
_DELTA: Final = 0.05  # s


class _RunHost(Host):
    """The served world of a run: in synchronous mode until the script says otherwise; its last episode is recorded."""

    def __init__(self, world: World, path: Path, campaign: Campaign) -> None:
        super().__init__(world, release=release_named(campaign.carla))
        self._path = path
        self._additional_data = campaign.additional_data
        self._synchronize()

    def begin_episode(self, town: Town, client: Client) -> None:
        """See `Host.begin_episode`."""
        if not self.settings.synchronous_mode:
            self._synchronize()
        super().begin_episode(town, client)
        self.world.recorder.start(self._path, self._additional_data, in_process=True)

    def _synchronize(self) -> None:
        self.apply_settings(EpisodeSettings(synchronous_mode=True, fixed_delta_seconds=_DELTA))


def run_script(campaign: Campaign, world: World, run: CampaignRun, path: Path) -> None:
    """Serve a world, whose recorder is on, to a script until it ends; it gets the seed and parameters of a run."""
    host, command = _RunHost(world, path, campaign), [str(campaign.python), str(campaign.function)]
    with asyncio.Runner() as runner:
        code = runner.run(_session(host, command, run))
    if code:
        raise RecapError(f"the script ends with exit code {code}")


async def _session(host: Host, command: list[str], run: CampaignRun) -> int:
    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    server = asyncio.create_task(serve(host, _ADDRESS, 0, port.set_result, load_ahead=False))
    await asyncio.wait((server, port), return_when=asyncio.FIRST_COMPLETED)
    if server.done():
        server.result()
        raise RecapError("the server has ended")
    given = {"host": _ADDRESS, "port": str(port.result()), **run.texts}
    options = [f"--{name}={value}" for name, value in given.items()]
    process = subprocess.Popen([*command, *options], env=_environment(run, port.result()))
    waiting = asyncio.create_task(asyncio.to_thread(process.wait))
    try:
        await asyncio.wait((server, waiting), return_when=asyncio.FIRST_COMPLETED)
    finally:
        process.kill()
        await waiting
        server.cancel()
        await asyncio.wait((server,))
    return waiting.result()


def _environment(run: CampaignRun, port: int) -> dict[str, str]:
    """Return the environment of a script: the server, a free port for a traffic manager, the seed and the parameters."""
    with socket.socket() as free:
        free.bind((_ADDRESS, 0))
        manager = free.getsockname()[1]
    return {
        **environment_of_user(),
        "CARLA_HOST": _ADDRESS,
        "CARLA_PORT": str(port),
        "CARLA_TM_PORT": str(manager),
        "CARLA_RECAP_SEED": str(run.seed),
        "CARLA_RECAP_PARAMETERS": json.dumps(dict(run.parameters)),
    }
