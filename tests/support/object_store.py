"""An object store on this machine: the S3 server of moto, in a process of its own."""

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import closing, contextmanager, suppress

import pytest

from tests.support.range_server import wait_until

BUCKET = "bucket"
KEYS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


def need_store():
    """Skip, with the reason, where there is no store to test with."""
    for name in ("obstore", "moto", "flask", "flask_cors"):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed: pip install -e '.[test]'")


class Bucket:
    """The bucket by boto3, not by the library that is tested."""

    def __init__(self, address):
        import boto3

        self._client = boto3.client(
            "s3",
            endpoint_url=address,
            region_name=KEYS["AWS_REGION"],
            aws_access_key_id=KEYS["AWS_ACCESS_KEY_ID"],
            aws_secret_access_key=KEYS["AWS_SECRET_ACCESS_KEY"],
        )

    def close(self):
        self._client.close()

    def make(self):
        self._client.create_bucket(Bucket=BUCKET)

    def __setitem__(self, key, data):
        self._client.put_object(Bucket=BUCKET, Key=key, Body=data)

    def __getitem__(self, key):
        with self._client.get_object(Bucket=BUCKET, Key=key)["Body"] as body:
            return body.read()

    def __contains__(self, key):
        found = self._client.list_objects_v2(Bucket=BUCKET, Prefix=key).get("Contents", [])
        return any(one["Key"] == key for one in found)


@contextmanager
def object_store():
    """The address of a store with an empty bucket `BUCKET`, and its process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: is_open(port) or process.poll() is not None)
        assert process.poll() is None
        address = f"http://127.0.0.1:{port}"
        with closing(Bucket(address)) as bucket:
            bucket.make()
        yield address
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()


def is_open(port):
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False


@contextmanager
def cut_off(address, *, up=None, down=None):
    """An address before a store that goes away after so many bytes to it, or from it."""
    host, _, port = address.removeprefix("http://").partition(":")
    listener = socket.create_server(("127.0.0.1", 0))
    left = {"up": up, "down": down}
    lock = threading.Lock()
    open_sockets: list[socket.socket] = []

    def end():
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        for one in open_sockets:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def pump(source, target, way):
        with suppress(OSError):
            while data := source.recv(1 << 14):
                with lock:
                    if left[way] is not None:
                        left[way] -= len(data)
                        if left[way] < 0:
                            end()
                            return
                target.sendall(data)
        with suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def accept():
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                store = socket.create_connection((host, int(port)))
                open_sockets.extend((client, store))
                threading.Thread(target=pump, args=(client, store, "up"), daemon=True).start()
                threading.Thread(target=pump, args=(store, client, "down"), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        end()
        for one in open_sockets:
            one.close()


def credentials(monkeypatch, address):
    """Set what a user of the store sets, and nothing else."""
    for name in [name for name in os.environ if name.startswith("AWS_")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_ENDPOINT_URL", address)
    for name, value in KEYS.items():
        monkeypatch.setenv(name, value)
