"""A node on another computer that knows the address: prints what it reaches, as JSON."""

import json
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="stranger" is_default_profile="true"><rtps><builtin>
    <initialPeersList>{peers}</initialPeersList>
  </builtin></rtps></participant>
</profiles>"""
LOCATOR = '<locator><udpv4><address>{}</address><port>{}</port></udpv4></locator>'
#: Ports of RTPS for discovery by unicast: base, gain by domain, offset, gain by participant.
BASE, BY_DOMAIN, OFFSET, BY_PARTICIPANT, PARTICIPANTS = 7400, 250, 10, 2, 12
#: How long a stranger tries [s].
PATIENCE = 15.0


def main(address, domain):
    ports = [BASE + BY_DOMAIN * domain + OFFSET + BY_PARTICIPANT * k for k in range(PARTICIPANTS)]
    with TemporaryDirectory() as folder:
        profile = Path(folder) / 'peers.xml'
        peers = ''.join(LOCATOR.format(address, port) for port in ports)
        profile.write_text(PROFILE.format(peers=peers))
        os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(profile)
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SUBNET'
        os.environ['ROS_STATIC_PEERS'] = address
        print(json.dumps(reached(domain)))


def reached(domain):
    """Nodes that are found, texts of programs that are received, and what a goal is answered."""
    import rclpy
    from cnc_interp_msgs.action import RunProgram
    from cnc_interp_msgs.msg import LoadedProgram
    from rclpy.action import ActionClient

    from cnc_interp.nodes.qos import LOADED
    from cnc_interp.processes.node_processes import NODES

    rclpy.init(domain_id=domain)
    node = rclpy.create_node('stranger')
    nodes, texts, answers, places = set(), [], [], {}
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline and not (answers and texts and nodes >= set(NODES)):
        rclpy.spin_once(node, timeout_sec=0.05)
        for name, place in node.get_node_names_and_namespaces():
            nodes.add(name)
            if name == 'program_node' and place not in places:
                places[place] = ActionClient(node, RunProgram, f'{place}/run_program')
                topic = f'{place}/loaded_program'
                node.create_subscription(
                    LoadedProgram, topic, lambda m: texts.append(m.text), LOADED
                )
        for place, action in places.items():
            if not isinstance(action, ActionClient):
                if action.done() and action not in answers:
                    answers.append(action)
            elif action.server_is_ready():
                places[place] = action.send_goal_async(RunProgram.Goal(program='/etc/passwd'))
    said = []
    for answer in answers:
        wanted = answer.result().get_result_async()
        rclpy.spin_until_future_complete(node, wanted, timeout_sec=PATIENCE)
        said.append(wanted.result().result.message if wanted.done() else 'accepted')
    return {'nodes': sorted(nodes - {'stranger'}), 'texts': texts, 'answers': said}


if __name__ == '__main__':
    main(sys.argv[1], int(sys.argv[2]))
