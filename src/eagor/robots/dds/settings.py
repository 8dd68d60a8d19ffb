"""The settings of a DDS domain: which network interface, and how processes find each other on it."""

from __future__ import annotations

import socket

from eagor._checks import whole
from eagor.errors import DeviceError

__all__ = ["LAST_DOMAIN", "checked_domain", "settings"]

LAST_DOMAIN = 232  # above, the ports that the standard derives from the number do not exist (DDSI-RTPS 9.6.1.1)
PARTICIPANTS = 64  # most processes of one domain on this machine: each has ports of its own
LOOPBACK = "lo"

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
