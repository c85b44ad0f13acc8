"""What the server does only because of how the official client 0.9.16, or the machine under it, behaves.

| quirk | symptom without it | place | tests |
|---|---|---|---|
| a script ends right after its last call, and its system resets the connection \
| that call, often `stop_recorder`, is lost | `quirks.unread_bytes` \
| `test_the_last_calls_of_a_client_that_has_left_are_served`, `test_what_arrived_before_a_write_failed_can_be_read` |
| `listen` returns before the client has subscribed | the datum of the tick that follows is lost \
| `quirks.PendingSubscriptions` | `test_synchronous_mode`, `test_a_tick_waits_for_the_subscriptions_of_its_client` |
| a client that begins an episode has none until its call has returned \
| learning of the new one from its stream before, its process aborts | `streams.SnapshotStreams` \
| `test_episodes_begin_while_it_lives`, `test_a_client_that_begins_an_episode_gets_it_in_a_new_stream` |
| its threads may then still be busy with a snapshot or an image of the episode before \
| its process aborts, now and then | `quirks.settled` \
| `test_the_world_is_loaded_anew_while_images_are_drawn`, `test_nothing_of_an_episode_is_sent_after_its_end` |
| meanwhile, the thread of its traffic manager looks at the episode | its process aborts \
| `traffic_manager.TrafficManagerPause` | `test_episodes_begin_while_it_lives`, `test_a_pause_waits_for_each_manager` |
| the client resets its traffic manager only when a snapshot has another episode than `get_episode_info` had \
| on a map that it has loaded, its traffic drives along the lanes of the map before | `host.Client` \
| `test_the_manager_keeps_left_on_the_map_that_its_client_loads` |
| CARLA's `BasicAgent` ignores what is exactly ahead, at an angle of 0; CARLA's vehicles, which settle on their springs, \
are never exactly in line | it drives into a car that stands in its lane | `quirks.slightly_aside` \
| `test_vehicles_in_a_lane_are_not_exactly_in_line` |
| the client signals a tick to its traffic manager without holding the manager's lock \
| client and manager wait for each other for ever | `traffic_manager.TrafficManagerCycle` \
| `test_a_tick_passes_once_the_manager_waits_for_it`, `test_a_manager_that_has_missed_a_tick_is_woken` |
| on a machine without a route to other networks, the client registers its traffic manager without host and port \
| the manager cannot be woken, no other client finds it, a second is refused | `calls.session.add_traffic_manager_running` \
| `test_a_manager_without_an_address_has_the_port_that_its_client_asked_about` |
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Final

from carla_recap.sim.geometry import Location, Transform

# --- unread calls -------------------------------------------------------------------------------------------------------

_MOST_UNREAD: Final = 1 << 16  # bytes


def unread_bytes(transport: asyncio.Transport) -> bytes:
    """Return what had arrived over a connection that broke while a reply was written.

    asyncio closes its socket without reading the rest, so this reads from a duplicate.
    """
    with suppress(OSError), transport.get_extra_info("socket").dup() as duplicate:
        data: bytes = duplicate.recv(_MOST_UNREAD)
        return data
    return b""


# --- subscriptions that are about to come -------------------------------------------------------------------------------

_SUBSCRIBED_BY: Final = 1.0  # s: a client that has asked for a token subscribes by then, or not at all


class PendingSubscriptions:
    """The subscriptions that clients are about to make: they have asked for the token of a stream."""

    def __init__(self) -> None:
        self._pending: dict[int, tuple[object, asyncio.Future[None], asyncio.TimerHandle]] = {}

    def expect(self, stream: int, client: object) -> None:
        """Expect a client to subscribe to a stream, over another connection."""
        self.arrived(stream)
        loop = asyncio.get_running_loop()
        self._pending[stream] = client, loop.create_future(), loop.call_later(_SUBSCRIBED_BY, self.arrived, stream)

    def of(self, client: object) -> list[asyncio.Future[None]]:
        """Return the subscriptions that a client is about to make; a tick of this client waits for them."""
        return [subscription for subscriber, subscription, _ in self._pending.values() if subscriber is client]

    def arrived(self, stream: int) -> None:
        """End the wait for a subscription, if there is one."""
        if stream in self._pending:
            _, subscription, limit = self._pending.pop(stream)
            limit.cancel()
            subscription.set_result(None)


# --- vehicles in line ---------------------------------------------------------------------------------------------------

_ASIDE: Final = 0.002  # m
_GOLDEN: Final = 0.618034  # per m: its products with two places rarely have the same fraction


def slightly_aside(transform: Transform) -> Transform:
    """Return the transform of a vehicle up to 2 mm to the side; how far depends on its place alone."""
    fraction = (transform.location.x + transform.location.y) * _GOLDEN % 1.0
    beside = transform.transform(Location(0.0, _ASIDE * (2 * fraction - 1), 0.0))
    return Transform(beside, transform.rotation)


# --- threads that are busy with the episode before ----------------------------------------------------------------------

_SETTLED: Final = 0.05  # s


async def settled() -> None:
    """Wait until clients have handled what they have been sent."""
    await asyncio.sleep(_SETTLED)
