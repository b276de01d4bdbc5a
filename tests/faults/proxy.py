"""A TCP proxy that spoils a link: delay, stall, reset, half-open. Orders on stdin.

{"delay_s": s}         each piece goes on so much later, both ways
{"stall": [ways]}      nothing is read any more on these ways ("up": to the server, "down": to the client); [] ends it
{"swallow": [ways]}    read and thrown away: the far end hears nothing, the near end thinks that it was heard
{"reset": true}        every connection ends with RST
{"half": true}         the server's side of every connection is closed, the client's is left open and told nothing
{"closed": true|false} new connections are refused with RST
"""

import argparse
import asyncio
import socket
import struct
import threading

import child

PIECE = 65536
ABORT = struct.pack("ii", 1, 0)


class Proxy:
    def __init__(self, target):
        self.target = target
        self.delay_s = 0.0
        self.stalled, self.swallowed = set(), set()
        self.closed = False
        self.pairs = []
        self.moved = asyncio.Event()

    async def accept(self, reader, writer):
        if self.closed:
            abort(writer)
            return
        try:
            far_reader, far_writer = await asyncio.open_connection(*self.target)
        except OSError:
            abort(writer)
            return
        pair = {"near": writer, "far": far_writer, "half": False}
        self.pairs.append(pair)
        ways = [self.carry(reader, far_writer, "up", pair), self.carry(far_reader, writer, "down", pair)]
        await asyncio.gather(*ways)
        self.pairs.remove(pair)

    async def carry(self, reader, writer, way, pair):
        """One direction: a reader into a queue, a writer out of it, each piece not before its time."""
        queue = asyncio.Queue(maxsize=256)
        sender = asyncio.create_task(self.send(queue, writer))
        loop = asyncio.get_running_loop()
        try:
            while True:
                while way in self.stalled:
                    await asyncio.sleep(0.005)
                piece = await reader.read(PIECE)
                if not piece:
                    break
                if way not in self.swallowed and not pair["half"]:
                    await queue.put((loop.time() + self.delay_s, piece))
        except OSError:
            pass
        await queue.put(None)
        await sender
        if not pair["half"]:
            writer.close()

    async def send(self, queue, writer):
        loop = asyncio.get_running_loop()
        while (item := await queue.get()) is not None:
            await asyncio.sleep(max(0.0, item[0] - loop.time()))
            try:
                writer.write(item[1])
                await writer.drain()
            except OSError:
                pass

    def obey(self, order):
        self.delay_s = order.get("delay_s", self.delay_s)
        self.closed = order.get("closed", self.closed)
        self.stalled = set(order.get("stall", self.stalled))
        self.swallowed = set(order.get("swallow", self.swallowed))
        if order.get("reset"):
            for pair in self.pairs:
                abort(pair["near"])
                abort(pair["far"])
        if order.get("half"):
            for pair in self.pairs:
                pair["half"] = True
                pair["far"].close()


def abort(writer):
    """Closes with RST: what waits is lost, and the other side is told rudely."""
    raw = writer.get_extra_info("socket")
    if raw is not None:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)
    writer.transport.abort()


async def serve(arguments):
    host, port = arguments.target.rsplit(":", 1)
    proxy = Proxy((host, int(port)))
    server = await asyncio.start_server(proxy.accept, "127.0.0.1", arguments.port)
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()

    def listen():
        for order in child.orders():
            loop.call_soon_threadsafe(proxy.obey, order)
        loop.call_soon_threadsafe(ended.set)

    threading.Thread(target=listen, daemon=True).start()
    child.say(ready=True)
    await ended.wait()
    server.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("port", type=int, help="listens here, on the loopback")
    parser.add_argument("target", help="HOST:PORT")
    asyncio.run(serve(parser.parse_args()))


if __name__ == "__main__":
    main()
