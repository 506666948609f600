"""Allowlist by address, and the warning about a port open to the network."""

from __future__ import annotations

import argparse

import pytest

from nclient.transports.listener import Allowlist, add_options, allowlist_from_options, is_loopback, warning


def parsed(*words: str) -> Allowlist:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return allowlist_from_options(parser.parse_args(words))


@pytest.mark.parametrize(("host", "let_in"), [
    # Addresses of this machine; IPv4 addresses as IPv6 sockets show them; addresses within and outside the two
    # networks.
    ("127.0.0.1", True), ("127.0.1.1", True), ("::1", True), ("", True), ("::ffff:127.0.0.1", True),
    ("192.168.1.7", True), ("::ffff:192.168.1.7", True), ("192.168.2.7", False), ("fe80::1%eth0", False),
    ("2001:db8::5", True), ("2001:db9::5", False),
])  # fmt: skip
def test_a_rule_lets_in_its_networks_and_this_machine(host: str, let_in: bool) -> None:
    assert parsed("--allow", "192.168.1.0/24", "--allow", "2001:db8::/32").allows(host) is let_in
    assert parsed().allows(host)


def test_equal_addresses_are_the_same_machine() -> None:
    rule = parsed("--allow", "10.9.9.0/24")
    # The client's address equals the one that it connected to: a client on this machine.
    assert rule.allows("192.0.2.2", "192.0.2.2")
    assert rule.allows("fd00::2", "fd00::2")
    assert not rule.allows("192.0.2.3", "192.0.2.2")
    assert not rule.allows("192.0.2.3", "")


# A host with bits behind the /24, and more than 32 bits.
@pytest.mark.parametrize("text", ["nowhere", "192.168.1.7/24", "1.2.3.4/33"])
def test_what_is_no_network_is_wrong_usage(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed("--allow", text)
    assert "such as 192.168.1.0/24" in capsys.readouterr().err


def test_loopback_is_not_worth_a_word_and_the_network_is() -> None:
    assert not warning("127.0.0.1", Allowlist())
    assert not warning("localhost", Allowlist())
    assert "any client that reaches it may drive" in warning("0.0.0.0", Allowlist())
    assert "--allow ADDRESS/BITS" in warning("::", Allowlist())
    reported = warning("0.0.0.0", parsed("--allow", "10.1.0.0/16"))
    assert "any client from 10.1.0.0/16 may drive" in reported
    assert "--allow" not in reported
    assert "any client that reaches it may listen;" in warning("0.0.0.0", Allowlist(), "may listen")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("robot.example")
