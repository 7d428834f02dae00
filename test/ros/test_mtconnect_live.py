"""The MTConnect agent beside real nodes: what a client reads is what the machine does."""

import re
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip('lxml', reason='needs requirements/mtconnect.txt')

from lxml import etree
from nodes_under_test import PATIENCE, clean_environment, hear_ctrl_c
from operated import MACHINE, PROGRAM, Bench, blocks_of


class Client:
    """Asks an agent over HTTP."""

    def __init__(self, address):
        self.address = address

    def get(self, target):
        with urllib.request.urlopen(self.address + target, timeout=PATIENCE) as answer:
            return etree.fromstring(answer.read())

    def values(self, target='/current'):
        """Return the text, or the level of a condition, of each data item."""
        found = {}
        for one in self.get(target).iter():
            if isinstance(one.tag, str) and one.get('dataItemId'):
                level = one.tag.rpartition('}')[2]
                text = f'{level}: {one.text}' if one.get('type') else one.text
                found.setdefault(one.get('dataItemId'), []).append(text)
        return found


@pytest.fixture(scope='module')
def served():
    bench = Bench()
    words = ['mtconnect', '--port', '0', '--namespace', bench.namespace]
    agent = subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', *words, '--domain', str(bench.domain)],
        stdout=subprocess.PIPE,
        text=True,
        env=clean_environment(),
        preexec_fn=hear_ctrl_c,
    )
    try:
        address = re.search(r'http://[^/]+', agent.stdout.readline())[0]
        client = Client(address)
        bench.spin_until(lambda: client.values()['availability'] == ['AVAILABLE'])
        yield bench, client, agent
    finally:
        agent.kill()
        bench.close()


@pytest.mark.thorough
def test_a_client_sees_the_run_the_stop_and_the_end(served):
    bench, client, agent = served
    assert client.values()['execution'] == ['READY'] and client.values()['parts'] == ['0']
    begin = int(client.get('/current')[0].get('nextSequence'))
    bench.single_block(False)
    bench.finish(bench.begin())
    bench.spin_until(lambda: client.values()['execution'] == ['PROGRAM_COMPLETED'])
    told = client.values(f'/sample?from={begin}&count=100000')
    lines = [int(line) for line in told['line'] if int(line)]
    wanted = set(blocks_of(PROGRAM).line_number[1:].tolist())
    assert lines == sorted(lines) and len(set(lines) & wanted) > len(wanted) // 2
    assert told['execution'][0] == 'ACTIVE' and told['parts'] == ['1']
    text = PROGRAM.splitlines()
    assert set(told['block']) - {None} <= set(text)
    feeds = np.array([float(feed) for feed in told['feed']])
    assert np.abs(feeds - 50.0).min() < 2.5, 'F3000'
    now, state = client.values(), bench.next_state()
    for number, name in enumerate(MACHINE.axis_names):
        unit = 1e-3 if MACHINE.axes[number].linear else np.pi / 180
        assert float(now[f'{name}_actual'][0]) * unit == pytest.approx(
            state.positions[number], abs=1e-6
        )
    assert now['system'] == now['logic'] == now['motion'] == ['Normal: None']
    words = ['tools', '5', '--length', '60', '--load', '--namespace', bench.namespace]
    words = [sys.executable, '-m', 'cnc_interp', *words, '--domain', str(bench.domain)]
    subprocess.run(words, check=True, env=clean_environment(), stdout=subprocess.DEVNULL)
    bench.spin_until(lambda: client.values()['tool'] == ['5'])
    (changed,) = client.values()['asset_changed']
    (tool,) = client.get(f'/asset/{changed}')[1]
    assert tool.get('toolId') == '5' and client.values()['tool_asset'] == [changed]
    bench.begin()
    bench.until_at(0.03)
    assert bench.press('emergency_stop').success
    bench.spin_until(lambda: client.values()['emergency_stop'] == ['TRIGGERED'])
    bench.spin_until(lambda: 'Fault' in client.values()['system'][0])
    assert 'emergency stop' in ' '.join(client.values()['system'])
    assert bench.press('reset').success
    bench.spin_until(lambda: client.values()['system'] == ['Normal: None'])
    assert client.values()['emergency_stop'] == ['ARMED']
    assert client.values()['parts'] == ['1'], 'a run that was stopped made no part'
    bench.kill('machine_node')
    while client.values()['availability'] != ['UNAVAILABLE']:
        assert agent.poll() is None
    assert client.values()['execution'] == ['UNAVAILABLE']
    agent.send_signal(signal.SIGINT)
    assert agent.wait(PATIENCE) == 0
