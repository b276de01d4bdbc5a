"""A Zenoh router in a process of its own: deploy/zenoh/router.json5 as it is shipped, on the endpoints given."""

import argparse
import json
import pathlib

import zenoh

import child

SHIPPED = pathlib.Path(__file__).resolve().parents[2] / "deploy" / "zenoh" / "router.json5"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("endpoints", nargs="+")
    parser.add_argument("--connect", nargs="*", default=[], help="other routers, looked for until they are there")
    arguments = parser.parse_args()
    config = zenoh.Config.from_file(str(SHIPPED))
    entries = {
        "listen/endpoints": arguments.endpoints,
        "connect/endpoints": arguments.connect,
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
    }
    for key, value in entries.items():
        config.insert_json5(key, json.dumps(value))
    session = zenoh.open(config)
    child.say(ready=True)
    for _ in child.orders():
        pass
    session.close()


if __name__ == "__main__":
    main()
