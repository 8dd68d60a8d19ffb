"""The settings of a DDS domain: which network interface, and how processes find each other on it."""

from __future__ import annotations

import random
import socket

from eagor._checks import whole
from eagor.errors import DeviceError

__all__ = ["LAST_DOMAIN", "checked_domain", "free_domain", "settings"]

LAST_DOMAIN = 232  # above, the ports that the standard derives from the number do not exist (DDSI-RTPS 9.6.1.1)
PARTICIPANTS = 64  # most processes of one domain on this machine: each has ports of its own
LOOPBACK = "lo"
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and per domain (DDSI-RTPS 9.6.1.1)
LOOKED_AT = 8  # participants of a domain whose ports tell whether it is in use
FREE = range(1, 120)  # above, ports meet those that the system gives away

# The loopback interface has no multicast, so processes ask each other's ports one by one.
_LOCAL = f"""<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
# Cyclone 0.10, which robots run, finds a newer one on the same machine only by an index (measured).
_NETWORK = """<CycloneDDS><Domain Id="any">
<General><Interfaces><NetworkInterface {which} multicast="default"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{most}</MaxAutoParticipantIndex></Discovery>
</Domain></CycloneDDS>"""


def checked_domain(domain: int) -> int:
    """The domain's number. Raises `DeviceError` if no such domain can be."""
    if not whole(domain, 0, LAST_DOMAIN):
        raise DeviceError(f"DDS domain {domain!r}; wanted a whole number from 0 to {LAST_DOMAIN} (ROS_DOMAIN_ID)")
    return int(domain)


def settings(interface: str | None) -> str:
    """Cyclone DDS's XML for a network interface ("eth0"); None lets it choose, "lo" stays on this machine.

    Raises `DeviceError` if there is no such interface.
    """
    if interface is None:
        return _NETWORK.format(which='autodetermine="true"', most=PARTICIPANTS)
    known = [name for _, name in socket.if_nameindex()]
    if interface not in known:
        raise DeviceError(f"there is no network interface {interface!r}; this machine has {', '.join(known)}")
    return _LOCAL if interface == LOOPBACK else _NETWORK.format(which=f'name="{interface}"', most=PARTICIPANTS)


def free_domain() -> int:
    """A DDS domain on which nobody of this machine listens, chosen at random: others may look for one right now.

    Raises `DeviceError` if there is none.
    """
    for domain in random.SystemRandom().sample(FREE, len(FREE)):
        if all(_is_free(FIRST_PORT + PORTS * domain + 10 + 2 * index) for index in range(LOOKED_AT)):
            return domain
    raise DeviceError("every DDS domain of this machine is in use: end some programs that use DDS")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
