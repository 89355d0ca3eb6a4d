"""The pages over a store in a bucket are those over a folder."""

import re

from flows.report.night.site import Site
from tests.flows.night.stores import STORED, fill


def test_pages_are_made_of_a_bucket_too(store):
    nights = fill(store)
    site = Site(nights.store)
    night = site.answer("night/latest.html").body.decode()
    assert "two_link #1: payload" in night
    (report,) = re.findall(r'href="\.\./(report/[0-9a-f]+/report\.html)"', night)
    assert site.answer(report).body == STORED
    record = site.answer(f"record/{nights.proposal}.html").body.decode()
    assert f"{nights.proposal}/proposal.html" in record
