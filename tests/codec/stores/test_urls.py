"""What a URL says: where a file is, and what may be shown of it."""

import pytest

from evogs_codec import InputError
from evogs_codec.stores.urls import Url, is_url


@pytest.mark.parametrize(
    ("text", "host", "path", "query", "name"),
    [
        ("s3://bucket/a/b c?#é.evogs", "bucket", "a/b c?#é.evogs", "", "b c_#é.evogs"),
        ("gs://bucket/key", "bucket", "key", "", "key"),
        ("https://h.org/a/b%20c.ply?sig=1%2F2#x", "h.org", "a/b%20c.ply", "sig=1%2F2", "b c.ply"),
        ("HTTP://h:80", "h:80", "", "", "file"),
        ("https://h/..", "h", "..", "", "file"),
        ("s3://b/..%2Fx", "b", "..%2Fx", "", "..%2Fx"),
        ("https://h/..%2Fx\0", "h", "..%2Fx\0", "", ".._x_"),
    ],
)
def test_a_url_has_a_place_and_a_name_for_a_file(text, host, path, query, name):
    url = Url.parse(text)
    assert (url.host, url.path, url.query, url.name) == (host, path, query, name)


def test_the_name_of_a_long_url_fits_a_folder_and_keeps_its_ending():
    name = Url.parse("s3://b/" + "x" * 900 + ".tree.npz").name
    assert len(name) < 100
    assert name.endswith(".npz")


def test_a_password_and_a_signature_are_asked_with_and_not_shown():
    url = Url.parse("https://user:secret@h.org/a?sig=secret")
    assert url.address == "https://user:secret@h.org/a?sig=secret"
    assert str(url) == "https://h.org/a"


@pytest.mark.parametrize(
    "text",
    [
        *("ftp://h/a", "s3://", "s3://bucket", "s3://bucket/", "gs://b/folder/", "s3:///key"),
        *("https://", "http://h:99999/x", "https://[::1/x"),
    ],
)
def test_a_url_that_names_no_file_is_refused(text):
    with pytest.raises(InputError, match=text.partition(":")[0]) as found:
        Url.parse(text)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("text", ["scene.ply", "s3", "s3:/bucket/key", "./https://x", "C://x", ""])
def test_other_text_is_a_path(text):
    assert not is_url(text)
