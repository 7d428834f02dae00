"""Print the last text of a topic that keeps it for late subscribers, as robot_description."""

import sys
import time

from std_msgs.msg import String

from cnc_interp.client.served_node import ServedNode
from cnc_interp.nodes import qos

PATIENCE = 10.0  #: Longest wait for a publisher [s].


def main() -> int:
    topic, heard = sys.argv[1], list[String]()
    with ServedNode('robot_description', '/') as served:
        served.node.create_subscription(String, topic, heard.append, qos.LOADED)
        end = time.monotonic() + PATIENCE
        while not heard and time.monotonic() < end:
            served.serve()
    if not heard:
        sys.exit(
            f'nobody publishes {topic} within {PATIENCE:g} s; start robot_state_publisher, or '
            'name a file'
        )
    print(heard[-1].data)
    return 0


if __name__ == '__main__':
    main()
