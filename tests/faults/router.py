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
    endpoints = parser.parse_args().endpoints
    config = zenoh.Config.from_file(str(SHIPPED))
    config.insert_json5("listen/endpoints", json.dumps(endpoints))
    session = zenoh.open(config)
    child.say(ready=True)
    for _ in child.orders():
        pass
    session.close()


if __name__ == "__main__":
    main()
