"""What readers make of a stream, bad or good, in a form that can be compared."""

from conformance.decoders import oracle
from evogs_codec import Decoder, StreamError, decode


def verdict(data):
    """The dump, or fault code and offset."""
    try:
        return decode(data, verify=True).dump()
    except StreamError as error:
        return error.fault.name, error.offset


def oracle_verdict(data):
    try:
        return oracle.decode(data, check_digests=True).dump()
    except oracle.FaultError as error:
        return error.code, error.offset


def fault_of(function, *args, **options):
    """(code, offset) that the codec reports, or None."""
    try:
        function(*args, **options)
    except StreamError as error:
        return error.fault.name, error.offset
    return None


def oracle_fault(function, *args, **options):
    try:
        function(*args, **options)
    except oracle.FaultError as fault:
        return fault.code, fault.offset
    return None


def feed(data):
    """Give a `Decoder` everything at once."""
    decoder = Decoder()
    decoder.feed(data)
    decoder.leaves()
    decoder.close()
