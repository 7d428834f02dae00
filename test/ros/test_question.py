"""A request whose answer is lost is asked again, or not, where it must not arrive twice."""

import math
import threading
import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from nodes_under_test import PATIENCE
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from std_srvs.srv import Trigger

from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.question import Question
from cnc_interp.processes.this_host import stay_on_this_host


class LosesAnswers:
    """A node that takes all requests of ``ask`` and answers from the second on."""

    def __init__(self, context):
        self.taken, self._taken_at = 0, math.inf
        self.node = rclpy.create_node('answers', namespace='/questions', context=context)
        self.node.create_service(Trigger, 'ask', self._answer)
        self._executor = EventsExecutor(context=context)
        self._executor.add_node(self.node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _answer(self, _request, response):
        self.taken, self._taken_at = self.taken + 1, time.monotonic()
        if self.taken == 1:
            raise LookupError('no answer leaves this node')
        response.message = str(self.taken)
        return response

    @property
    def taken_for(self):
        """Time since a request was taken [s]; below 0 before."""
        return time.monotonic() - self._taken_at

    def _serve(self):
        while not self._ended.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.05)
            except LookupError:
                continue
            except ExternalShutdownException:
                return

    def close(self):
        self._ended.set()
        self._thread.join()
        self.node.destroy_node()


@pytest.fixture
def ask():
    """Return a function that asks until something is done and returns the answer; the other."""
    stay_on_this_host()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=91)
    other = LosesAnswers(context)
    node = rclpy.create_node('asks', namespace='/questions', context=context)
    executor = EventsExecutor(context=context)
    executor.add_node(node)

    def asking(again, done=lambda: False):
        question = Question(node.create_client(Trigger, 'ask'), Trigger.Request(), again)
        until = time.monotonic() + PATIENCE
        while question.answer() is None and not done():
            assert time.monotonic() < until
            executor.spin_once(timeout_sec=0.02)
        return question.answer()

    yield asking, other
    other.close()
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_lost_answer_is_asked_for_again(ask):
    asking, other = ask
    # A busy computer answers so late that it is asked once more.
    assert 2 <= int(asking(0.3).message) <= other.taken


def test_what_must_not_arrive_twice_is_sent_once(ask):
    asking, other = ask
    assert asking(math.inf, lambda: other.taken_for > 1.0) is None
    assert other.taken == 1


@pytest.mark.parametrize('answers', [False, True])
def test_what_starts_is_sent_only_to_a_node_that_answers_here(answers):
    """A node that has not found this client acts, and its answer is lost."""
    stay_on_this_host()
    context, taken = rclpy.Context(), []
    rclpy.init(context=context, domain_id=91)
    node = rclpy.create_node(
        'machine_node', namespace='/knocks', context=context, start_parameter_services=answers
    )

    def start(_request, response):
        taken.append(time.monotonic())
        response.success = True
        return response

    node.create_service(Trigger, 'cycle_start', start)
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    with OperatorClient('operator', '/knocks', 91) as client:
        until = time.monotonic() + PATIENCE
        while not client.offers('cycle_start'):
            assert time.monotonic() < until
            client.serve()
        asked = client.ask('cycle_start')
        while not asked.done():
            executor.spin_once(timeout_sec=0.01)
            client.serve(0.01)
    node.destroy_node()
    rclpy.shutdown(context=context)
    assert (asked.result().ok, len(taken)) == (answers, int(answers))
    assert answers or 'not sent' in asked.result().message
