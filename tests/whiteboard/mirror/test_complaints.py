"""Lines of Zenoh's log, as 1.10 writes them; test_tls.py sees that it still does."""

from __future__ import annotations

import pytest

from llfsm.whiteboard.mirror.complaints import understand

UNABLE = "zenoh::net::runtime::orchestrator: Unable to connect to configured peer"
SOURCE = "at /root/src/unicast.rs:378.. Retry in 100ms."
LINK = 'Can not create a new TLS link bound to DnsName("robot"):'


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (
            "\x1b[2mT\x1b[0m \x1b[33m WARN\x1b[0m rx-2 \x1b[2mzenoh_link_tls::unicast\x1b[0m"
            "\x1b[2m:\x1b[0m invalid peer certificate: UnknownIssuer. Hint: increase the limit.",
            ("a connection", "invalid peer certificate: UnknownIssuer"),
        ),
        (
            f"T DEBUG rx-1 {UNABLE} tls/robot:1! {LINK} invalid peer certificate: Expired {SOURCE}",
            ("by tls/robot:1", "invalid peer certificate: Expired"),
        ),
        (
            f"T DEBUG rx-1 {UNABLE} tls/[::1]:1! received fatal alert: UnknownCA {SOURCE}",
            ("by tls/[::1]:1", "received fatal alert: UnknownCA"),
        ),
        (f"T DEBUG rx-1 {UNABLE} tls/robot:1! deadline has elapsed. Retry in 100ms.", None),
        (f"T DEBUG {UNABLE} tls/r:1! {LINK} Connection refused (os error 111) {SOURCE}", None),
        ("T DEBUG rx-1 zenoh::net::runtime::orchestrator: Try to connect: tls/robot:1", None),
        ("", None),
    ],
)
def test_what_is_refused_is_told_and_other_things_are_not(
    line: str, found: tuple[str, str] | None
) -> None:
    assert understand(line) == found
