"""Counts of a link, and its latencies in fixed buckets."""

from __future__ import annotations

from itertools import pairwise

from nclient.backends.base import BUCKETS_S, LinkStatistics


def test_buckets_double_from_a_tenth_of_a_millisecond() -> None:
    assert BUCKETS_S[0] == 0.0001
    assert all(after == 2 * before for before, after in pairwise(BUCKETS_S))
    link = LinkStatistics()
    for seconds in (0.0, 0.0001, 0.00011, 0.0002, 60.0):
        link.record_latency(seconds)
    # 0 and 0.0001 in the first bucket, 0.00011 and 0.0002 in the second, 60 s in the last, which has no upper limit.
    assert link.latencies[:2] == [2, 2]
    assert link.latencies[-1] == 1
    assert sum(link.latencies) == link.answers == 5


def test_latency_quantiles() -> None:
    link = LinkStatistics()
    assert link.latency_s(0.99) == 0
    for _ in range(98):
        link.record_latency(0.003)
    link.record_latency(0.02)
    link.record_latency(100.0)
    # A quantile is the upper limit of its bucket: 0.0001 x 2^5; 0.02 s is the 99th value, in the bucket up to 0.0256
    # s.
    assert link.latency_s(0.5) == BUCKETS_S[5] == 0.0032
    assert link.latency_s(0.99) == BUCKETS_S[8]
    assert link.latency_s(1.0) == 100.0


def test_a_summary_lists_only_faults_that_occurred() -> None:
    link = LinkStatistics()
    assert str(link) == "0 exchanges, 0 answers\nno faults seen\nno times yet"
    link.exchanges, link.checksum_errors, link.timeouts, link.retries = 3, 1, 2, 2
    link.record_latency(0.005)
    assert str(link) == (
        "3 exchanges, 1 answers\n1 checksum errors, 2 timeouts, 2 retries\n"
        "50% within 5 ms, 99% within 5 ms, the longest 5 ms"
    )
    assert link.counts()["checksum_errors"] == 1
    assert "latencies" not in link.counts()
