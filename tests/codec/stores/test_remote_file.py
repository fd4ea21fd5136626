"""A file behind a URL: of a good server the bytes asked for, of a bad one a clear error."""

import errno
import gc
import json
import signal
import sys
import threading
from collections import namedtuple
from datetime import timedelta

import pytest

from evogs_codec import InputError, RemoteFile, put_object
from evogs_codec.stores import client, remote_file
from evogs_codec.stores.remote_file import FIRST_BYTES, MAX_GAP
from tests.codec.stores.conftest import BYTES
from tests.support.range_server import MOST, serving

CORNERS = [(100, 200), (1_000_000, 1_000_010), (2_999_000, 9_000_000)]


def same(view, ranges=CORNERS):
    return all(view[begin:end] == BYTES[begin:end] for begin, end in ranges)


# --- good servers ---------------------------------------------------------------------------------


def test_only_the_ranges_asked_for_are_fetched_and_each_once(site):
    with RemoteFile(f"{site.url}a.bin") as remote:
        assert remote.size == len(BYTES)
        assert same(remote.having(CORNERS))
        assert same(remote.having(CORNERS))
        assert remote.n_fetched == FIRST_BYTES + 10 + 1000 == site.n_sent
    assert site.asked == ["bytes=0-32767", *site.asked[1:]]
    assert {*site.asked[1:]} == {"bytes=1000000-1000009", "bytes=2999000-2999999"}


def test_ranges_with_small_gaps_are_one_request(site):
    with RemoteFile(f"{site.url}a.bin") as remote:
        remote.having([(100_000, 100_001), (100_001 + MAX_GAP, 100_002 + MAX_GAP)])
        remote.having([(200_000, 200_001), (200_002 + MAX_GAP, 200_003 + MAX_GAP)])
        assert remote.n_requests == 1 + 1 + 2


def test_bytes_between_are_not_fetched_again(site):
    with RemoteFile(f"{site.url}a.bin") as remote:
        remote.having([(100_000, 200_000)])
        assert bytes(remote.having([(0, 300_000)])[:300_000]) == BYTES[:300_000]
        assert remote.n_fetched == 300_000


def test_a_large_range_comes_in_pieces_with_progress(site, monkeypatch):
    monkeypatch.setattr(remote_file, "PIECE_BYTES", 100_000)
    told = []
    with RemoteFile(f"{site.url}a.bin") as remote:
        path = remote.whole(lambda stage, part: told.append((stage, part)))
        assert path.read_bytes() == BYTES
        assert path.name == "a.bin"
        assert remote.n_requests == 1 + 30
    assert told == sorted(told)
    assert told[-1] == ("fetch", 1.0)


def test_small_and_empty_files_are_read(site):
    with RemoteFile(f"{site.url}small") as remote:
        assert bytes(remote.having([(0, 99)])) == b"small"
    with RemoteFile(f"{site.url}empty") as remote:
        assert (remote.size, bytes(remote.having([(0, 99)]))) == (0, b"")


def test_the_signature_of_an_address_is_sent_and_not_shown(site):
    with RemoteFile(f"{site.url}small?sig=secret") as remote:
        assert remote.size == 5
        assert "secret" not in repr(remote)
    with pytest.raises(FileNotFoundError) as found:
        RemoteFile(f"{site.url}gone?sig=secret")
    assert "secret" not in str(found.value)
    assert found.value.filename == f"{site.url}gone"


def test_the_scratch_file_goes_with_the_object(site):
    remote = RemoteFile(f"{site.url}a.bin")
    view, folder = remote.having(CORNERS), remote.path.parent
    remote.close()
    assert not folder.exists()
    assert same(view)
    remote = RemoteFile(f"{site.url}a.bin")
    folder = remote.path.parent
    assert folder.exists()
    del remote
    gc.collect()
    assert not folder.exists()


# --- versions -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tag", "sent"), [('"one"', '"one"'), ('W/"one"', None), (None, None)])
def test_a_strong_tag_is_a_condition_of_later_requests(site, tag, sent):
    site.tag = tag
    with RemoteFile(f"{site.url}a.bin") as remote:
        remote.having(CORNERS)
    assert site.conditions == [None, sent, sent]


@pytest.mark.parametrize("manner", ["good", "unconditional"])
@pytest.mark.parametrize("tag", ['"one"', 'W/"one"'])
def test_a_file_that_changes_while_it_is_read_is_refused(site, manner, tag):
    site.tag, site.manner = tag, manner
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.tag = tag.replace("one", "two")
        with pytest.raises(OSError, match="has changed while it was read") as found:
            remote.having(CORNERS)
        assert found.value.filename == f"{site.url}a.bin"


def test_a_file_whose_size_changes_is_refused_without_tags_too(site):
    site.tag = None
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.files["a.bin"] = BYTES + b"x"
        with pytest.raises(OSError, match="has changed"):
            remote.having(CORNERS)


# --- servers that break off -----------------------------------------------------------------------


@pytest.mark.parametrize("tag", ['"one"', None])
def test_an_answer_that_breaks_off_is_asked_for_again(site, tag):
    site.tag = tag
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.n_breaks = 2
        assert same(remote.having([(1_000_000, 2_000_000)]), [(1_000_000, 2_000_000)])


def test_a_busy_server_is_asked_again(site, monkeypatch):
    monkeypatch.setitem(client.RETRIES["backoff"], "init_backoff", timedelta(milliseconds=10))
    site.n_busy = 2
    with RemoteFile(f"{site.url}small") as remote:
        assert bytes(remote.having([(0, 5)])) == b"small"


def test_a_server_that_always_breaks_off_is_given_up(site):
    site.tag = None
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.n_breaks = 99
        with pytest.raises(OSError, match="cannot be read") as found:
            remote.having([(1_000_000, 1_001_000)])
        assert found.value.filename == f"{site.url}a.bin"
    assert len(site.asked) == 1 + remote_file.MAX_TRIES


def test_a_server_that_is_gone_is_given_up():
    pytest.importorskip("obstore", reason="URLs need obstore: pip install -e '.[stores]'")
    with serving({"a.bin": BYTES}) as site:
        remote = RemoteFile(f"{site.url}a.bin")
    with remote, pytest.raises(OSError, match="cannot be read"):
        remote.having(CORNERS)


def test_a_server_that_falls_silent_is_given_up(site, monkeypatch):
    monkeypatch.setattr(client, "READ_TIMEOUT", timedelta(milliseconds=100))
    monkeypatch.setitem(client.RETRIES, "max_retries", 1)
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.manner = "silent"
        with pytest.raises(OSError, match="cannot be read"):
            remote.having(CORNERS)


@pytest.fixture
def interrupts():
    """Ctrl-C raises, also where tests run in processes that ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_waiting_for_a_server_can_be_interrupted(site):
    main = threading.get_ident()
    site.manner, site.on_silence = "silent", lambda: signal.pthread_kill(main, signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        RemoteFile(f"{site.url}a.bin")


# --- servers that ignore ranges -------------------------------------------------------------------


def test_a_server_that_ignores_ranges_is_read_in_order_and_no_further_than_needed(site):
    site.manner = "no ranges"
    with pytest.warns(UserWarning, match=r"a\.bin: the server ignores ranges"):
        remote = RemoteFile(f"{site.url}a.bin")
    with remote:
        assert same(remote.having([(0, 1000)]), [(0, 1000)])
        assert remote.n_fetched < len(BYTES)
        assert same(remote.having(CORNERS))
        assert remote.n_fetched == len(BYTES)
    assert site.asked == ["bytes=0-32767", None]


def test_a_whole_answer_that_breaks_off_is_asked_for_again(site):
    site.manner, site.tag = "no ranges", None
    with pytest.warns(UserWarning, match="ignores ranges"):
        remote = RemoteFile(f"{site.url}a.bin")
    site.n_breaks = 1
    remote._version = remote._begin_stream()  # the one that breaks off
    with remote:
        assert remote.whole().read_bytes() == BYTES


def test_a_server_that_ignores_ranges_later_is_refused(site):
    with RemoteFile(f"{site.url}a.bin") as remote:
        site.manner = "no ranges"
        with pytest.raises(OSError, match="sends whole files only"):
            remote.having(CORNERS)


# --- servers that lie -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("manner", "said"),
    [
        ("forbidden", "may not be read: the credentials do not allow it"),
        ("other range", "cannot be read: Requested 0..32768, got 1..32769"),
        ("too short", "16,384 bytes came of 32,768 that were asked for"),
        ("endless", "cannot be read: Content-Length Header missing"),
        ("huge", "has 4,611,686,018,427,387,904 bytes, for which there is no scratch file"),
    ],
)
def test_a_wrong_answer_is_one_line_that_names_the_file(site, manner, said):
    site.manner = manner
    with pytest.raises(OSError, match=r"a\.bin") as found:
        RemoteFile(f"{site.url}a.bin?sig=secret")
    told = str(found.value.strerror)
    assert told.startswith(said)
    assert found.value.filename == f"{site.url}a.bin"
    assert "\n" not in told
    assert "script" not in told


def test_no_more_is_taken_than_was_asked_for(site):
    site.manner = "too long"
    with RemoteFile(f"{site.url}a.bin") as remote:
        assert same(remote.having([(0, 1000)]), [(0, 1000)])
        assert remote.n_fetched == FIRST_BYTES
        assert remote.path.stat().st_size == len(BYTES)
    assert site.n_sent < MOST // 8


def test_what_the_disk_cannot_hold_is_not_fetched(site, monkeypatch):
    usage = namedtuple("usage", "total used free")
    with RemoteFile(f"{site.url}a.bin") as remote:
        monkeypatch.setattr("shutil.disk_usage", lambda _: usage(9, 0, 9))
        with pytest.raises(OSError, match="1,010 bytes are to be fetched") as found:
            remote.having(CORNERS)
    assert found.value.errno == errno.ENOSPC


# --- what else may be wrong -----------------------------------------------------------------------


def test_a_file_that_is_not_there_is_not_found(site):
    with pytest.raises(FileNotFoundError, match="is not there"):
        RemoteFile(f"{site.url}gone")


def test_the_web_is_not_written_to(site):
    with pytest.raises(InputError, match="only s3:// and gs:// can be written"):
        put_object(f"{site.url}new", b"x")
    assert "new" not in site.files


def test_a_url_without_the_library_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(InputError, match=r"^s3://b/k: URLs need obstore: pip install -e '.*stores"):
        RemoteFile("s3://b/k")


def test_objects_of_google_are_read_and_written(site, monkeypatch, tmp_path):
    account = tmp_path / "account.json"
    account.write_text(
        json.dumps(
            {
                "gcs_base_url": site.url.rstrip("/"),
                "disable_oauth": True,
                "client_email": "",
                "private_key": "",
                "private_key_id": "",
            }
        )
    )
    monkeypatch.setenv("GOOGLE_SERVICE_ACCOUNT", str(account))
    put_object("gs://bucket/a b.bin", BYTES)
    assert site.files["bucket/a b.bin"] == BYTES
    with RemoteFile("gs://bucket/a b.bin") as remote:
        assert same(remote.having(CORNERS))
