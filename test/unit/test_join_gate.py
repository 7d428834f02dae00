"""A plan joins in motion only with a reserve of its own."""

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.run.run_state import RunId
from cnc_interp.wire.path_messages import JoinGate

NOW, NEXT, AFTER = RunId('p'), RunId('p', plan=1), RunId('p', plan=2)
FAR = 10_000


def chunk(run_id, first, joins=False, wait=SetpointChunk.NOTHING):
    return SetpointChunk(
        program_id=run_id.program_id,
        attempt=run_id.attempt,
        plan=run_id.plan,
        joins=joins,
        first_sample=first,
        sequences=[1] * 5,
        wait=wait,
    )


def pass_all(gate, *chunks, limit=FAR):
    return [each.first_sample for c in chunks for each in gate.passed(c, NOW, limit)]


def test_what_is_received_already_goes_on_and_a_plan_that_joins_waits_for_its_reserve():
    gate = JoinGate(20)
    joining = [chunk(NEXT, 100 + 5 * k, joins=k == 0) for k in range(5)]
    assert pass_all(gate, *joining[:3]) == []
    assert pass_all(gate, chunk(NOW, 400)) == [400], 'the plan before goes on'
    assert pass_all(gate, joining[3]) == [100, 105, 110, 115], 'all at once'
    assert [c.first_sample for c in gate.passed(joining[4], NEXT, FAR)] == [120]
    assert [c.first_sample for c in gate.passed(joining[0], NEXT, FAR)] == [100], 'a repeat'


@pytest.mark.parametrize('wait', [SetpointChunk.OVERRIDE, SetpointChunk.END])
def test_a_plan_that_comes_to_rest_needs_no_more(wait):
    assert pass_all(JoinGate(20), chunk(NEXT, 100, True), chunk(NEXT, 105, wait=wait)) == [
        100,
        105,
    ]


def test_where_no_more_may_be_sent_the_plan_is_not_kept_for_ever():
    assert pass_all(JoinGate(200), chunk(NEXT, 100, True), chunk(NEXT, 105), limit=110) == [
        100,
        105,
    ]


def test_after_a_loss_the_repeat_counts_from_its_beginning():
    gate = JoinGate(15)
    assert pass_all(gate, chunk(NEXT, 100, True), chunk(NEXT, 110)) == [], '105 is lost'
    again = [chunk(NEXT, 100 + 5 * k, joins=k == 0) for k in range(3)]
    assert pass_all(gate, *again) == [100, 105, 110]


def test_a_later_plan_takes_the_place_of_one_that_waits():
    gate = JoinGate(10)
    assert pass_all(gate, chunk(NEXT, 100, True), chunk(AFTER, 140, True)) == []
    assert pass_all(gate, chunk(AFTER, 145)) == [140, 145]
