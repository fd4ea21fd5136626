"""Verdicts on single answers: what is expected, what came, and how the difference is told."""

import hashlib
from dataclasses import replace

import pytest

from conformance.harness import manifest
from conformance.harness.judging.canary import canaries
from conformance.harness.judging.diagnosis import Fingerprint, accepts_any, diagnose
from conformance.harness.judging.dumps import channel_name, difference
from conformance.harness.judging.families import expand
from conformance.harness.judging.judging import KINDS, judge
from conformance.harness.running.answers import Answer, AnswerError, read_entry, read_fault
from tests.conformance.tiny import EXAMPLE


def cases_of(folder):
    return {case.id: case for case in manifest.load(folder).cases()}


# --- verdicts -------------------------------------------------------------------------------------


def verdict(folder, case_id, answer, lacking=(), codes=True):
    suite = manifest.load(folder)
    case = cases_of(folder)[case_id]
    return judge(case, answer, list(lacking), suite.golden, codes=codes)


def golden_of(folder, case_id):
    suite = manifest.load(folder)
    return suite.golden(cases_of(folder)[case_id].run.dump)


@pytest.mark.parametrize(
    ("case_id", "answer", "kind"),
    [
        ("core-example#0", Answer(0), "wrong dump"),
        ("core-example#0", Answer(1, code="E_CRC", offset=0), "wrong verdict"),
        ("core-example#0", Answer(127), "wrong verdict"),
        ("core-example#0", Answer(None, trouble="crash", detail="SIGSEGV"), "crash"),
        ("crc-of-a-packet#0", Answer(1, code="E_CRC", offset=457), "pass"),
        ("crc-of-a-packet#0", Answer(1, output=b"", code="E_CRC", offset=457), "pass"),
        ("crc-of-a-packet#0", Answer(1, code="E_CRC", offset=0), "wrong code"),
        ("crc-of-a-packet#0", Answer(1), "wrong code"),
        ("crc-of-a-packet#0", Answer(1, output=b"x", code="E_CRC", offset=457), "stray output"),
        ("crc-of-a-packet#0", Answer(0), "wrong verdict"),
        ("crc-of-a-packet#0", Answer(4), "wrong verdict"),
        ("core-example#7", Answer(4, code="E_LIMIT", offset=207), "pass"),
        ("critical-chunk#0", Answer(127, code="E_UNSUPPORTED", offset=64), "pass"),
        ("critical-chunk#0", Answer(1, code="E_UNSUPPORTED", offset=64), "wrong verdict"),
    ],
)
def test_an_answer_gets_the_verdict(made_suite, case_id, answer, kind):
    result = verdict(made_suite, case_id, answer)
    assert result.kind == kind, result.says
    assert kind in KINDS
    assert result.failed == (kind != "pass")


def test_codes_are_judged_only_of_decoders_that_declare_them(made_suite):
    assert verdict(made_suite, "crc-of-a-packet#0", Answer(1), codes=False).kind == "pass"


def test_a_run_is_skipped_only_if_the_feature_is_declared_missing_and_127_is_answered(made_suite):
    lacking = ["progressive mode"]
    assert verdict(made_suite, "core-example#3", Answer(127), lacking).kind == "skipped"
    assert verdict(made_suite, "core-example#3", Answer(127)).kind == "wrong verdict"
    assert verdict(made_suite, "core-example#3", Answer(1), lacking).kind == "wrong verdict"
    dump = golden_of(made_suite, "core-example#3")
    assert verdict(made_suite, "core-example#3", Answer(0, dump), lacking).kind == "pass"
    assert verdict(made_suite, "core-example#3", Answer(127, dump), lacking).failed


# --- where a dump is wrong ------------------------------------------------------------------------


def changed(dump, at, value):
    return dump[:at] + value + dump[at + len(value) :]


def test_a_wrong_dump_is_told_by_level_tile_slot_and_channel(made_suite):
    dump = golden_of(made_suite, "core-example#2")
    at = 16 + 28 + 4 + 4 * (7 * 4 + 1)  # channel 7, slot 1 of 4
    wrong = Answer(0, changed(dump, at, (-149).to_bytes(4, "little", signed=True)))
    says = verdict(made_suite, "core-example#2", wrong).says
    assert says.startswith("level 1, tile 0, slot 1, channel 7 scale x: -149, not -150")
    assert "1 of 56 integers" in says


def test_usual_mistakes_of_dumps_are_named(made_suite):
    dump = golden_of(made_suite, "core-example#0")
    assert difference(dump, dump) == ""
    assert difference(b"", dump) == "the dump is empty"
    assert "not even" in difference(dump[:9], dump)
    assert "right as far as they go" in difference(dump[:-1], dump)
    assert difference(dump + b"xy", dump) == "2 bytes follow the dump"
    assert "magic is 45 56 47 58" in difference(changed(dump, 3, b"X"), dump)
    assert "n_tiles is 0, not 1" in difference(changed(dump, 12, bytes(4)), dump)
    assert "3 slots, not 4" in difference(changed(dump, 40, b"\3"), dump)
    assert "origin" in difference(changed(dump, 16, b"\1"), dump)
    assert "slot 2: the live byte is 1, not 0" in difference(changed(dump, 46, b"\1"), dump)
    assert "ends at byte" in difference(changed(dump, 40, b"\xff"), dump)
    body = dump[48:]
    integers = [body[at : at + 4] for at in range(0, len(body), 4)]
    swapped = b"".join(integer[::-1] for integer in integers)
    assert "big-endian" in difference(dump[:48] + swapped, dump)
    turned = b"".join(integers[c * 4 + s] for s in range(4) for c in range(14))
    assert "slot by slot" in difference(dump[:48] + turned, dump)
    assert "another order" in difference(dump[:48] + b"".join(reversed(integers)), dump)


def test_channels_have_the_names_of_the_spec():
    assert [channel_name(c) for c in (0, 6, 10)] == ["position x", "rotation z", "opacity"]
    assert channel_name(11) == "SH 0 R (band 0)"
    assert channel_name(11 + 3 * 9 + 2) == "SH 9 B (band 3)"


# --- the contract's lines -------------------------------------------------------------------------


def test_lines_of_the_contract_are_read_strictly():
    assert read_fault(b'{"code": "E_CRC", "offset": 371}\n') == ("E_CRC", 371)
    assert read_entry(b'{"id": 5, "exit": 3}', 5) == (3, None, None)
    for line in ("", "\n", "[]", "{", '{"code": 1}', '{"why": ""}', "{}\n{}", '{"offset": true}'):
        with pytest.raises(AnswerError):
            read_fault(line.encode())
    for entry in (b'{"id": 4, "exit": 0}', b'{"exit": 0}', b'{"id": 5}', b"[5, 0]", b"\xff"):
        with pytest.raises(AnswerError):
            read_entry(entry, 5)
    for status in ("2", "true", "-11", '"0"'):
        with pytest.raises(AnswerError, match="means nothing"):
            read_entry(b'{"id": 5, "exit": %s}' % status.encode(), 5)


# --- families and canaries ------------------------------------------------------------------------


def test_families_expand_to_every_prefix_and_every_bit(made_suite):
    cases = list(expand(manifest.load(made_suite)))
    ids = [case.id for case in cases]
    assert len(set(ids)) == len(ids) == 2 * 519 + 1 + 8 * 519
    by_id = dict(zip(ids, cases, strict=True))
    for size, offset in ((0, 0), (63, 0), (64, 64), (370, 64), (371, 371), (457, 457), (518, 457)):
        case = by_id[f"prefix-example@{size}#0"]
        assert (case.run.code, case.run.offset) == ("E_TRUNCATED", offset)
        assert case.data == EXAMPLE[:size]
    assert by_id["prefix-example@370#1"].run.dump is None
    assert by_id["prefix-example@371#1"].run.exit == 3
    assert by_id["prefix-example@519#1"].run.exit == 0
    assert by_id["flip-example@8#0"].data[1] == EXAMPLE[1] ^ 1


def test_canaries_are_new_each_time_and_the_same_for_a_seed(made_suite):
    suite = manifest.load(made_suite)
    critical, ancillary = canaries(suite, 1)
    assert (critical.run.exit, ancillary.run.exit) == (127, 0)
    assert critical.data != canaries(suite, 2)[0].data
    assert critical.data == canaries(suite, 1)[0].data
    assert critical.data[64:65].isupper()
    assert ancillary.data[64:65].islower()


# --- diagnosis ------------------------------------------------------------------------------------


def results_of(folder, answers):
    """Results of the cases with right answers but for some."""
    suite = manifest.load(folder)
    results = []
    for case in suite.cases():
        run = case.run
        dump = None if run.dump is None else suite.golden(run.dump)
        answer = answers.get(case.id, Answer(run.exit, dump, run.code, run.offset))
        results.append(judge(case, answer, [], suite.golden, codes=True))
    return results


def test_a_decoder_is_told_which_known_wrong_one_it_looks_like(made_suite):
    dump = golden_of(made_suite, "core-example#2")
    wrong = Answer(0, dump[:-4] + bytes(4))
    answers = {"core-example#0": wrong, "core-example#2": wrong}
    results = results_of(made_suite, answers)
    text = "0:" + hashlib.sha256(wrong.output or b"").hexdigest()[:12]
    both = {"core-example#0": text, "core-example#2": text}
    fingerprints = {
        "off": Fingerprint("one thing", both, {}),
        "near": Fingerprint("another", {"core-example#0": text}, {}),
        "far": Fingerprint("a third", {"crc-of-a-packet#0": "0:-"}, {}),
    }
    found = diagnose(results, fingerprints, codes=True)
    first, second = found.alike
    assert (first.name, first.share, second.name, second.share) == ("off", 1.0, "near", 0.5)
    (sentence,) = found.sentences()
    assert sentence.startswith("this looks like off: one thing; first seen: core-example#2, level")
    assert "level 1, tile 0, slot 3" in sentence
    assert sentence.endswith("(explains all wrong runs)")
    assert diagnose(results_of(made_suite, {}), fingerprints, codes=True).sentences() == []


def test_codes_tell_wrong_decoders_apart_if_they_are_reported(made_suite):
    results = results_of(made_suite, {"crc-of-a-packet#0": Answer(1, code="E_ZSTD", offset=457)})
    crash = results_of(made_suite, {"core-example#0": Answer(None, trouble="timeout")})
    fingerprints = {
        "late": Fingerprint("checks late", {}, {"crc-of-a-packet#0": "E_ZSTD@457"}),
        "loop": Fingerprint("never ends", {"core-example#0": "crash"}, {}),
    }
    (found,) = diagnose(results, fingerprints, codes=True).alike
    assert (found.name, found.share) == ("late", 1.0)
    assert diagnose(results, fingerprints, codes=False).alike == ()
    (found,) = diagnose(crash, fingerprints, codes=True).alike
    assert found.name == "loop"


def test_nothing_is_told_of_a_decoder_that_accepts_no_legal_stream(made_suite):
    right = results_of(made_suite, {})
    legal = [result.case.id for result in right if result.case.run.exit in (0, 3)]
    results = results_of(made_suite, {case: Answer(1, code="E_CRC", offset=0) for case in legal})
    assert not accepts_any(results)
    prints = {"crc": Fingerprint("refuses", dict.fromkeys(legal, "1:-"), {})}
    found = replace(diagnose(results, prints, codes=True), accepts=False)
    (sentence,) = found.sentences()
    assert sentence.startswith(
        "no legal stream was accepted: any check that always fails, as of cr"
    )
    one_wrong = results_of(made_suite, {legal[0]: Answer(1)})
    assert accepts_any(one_wrong)
    assert accepts_any([result for result in results if result.case.run.exit == 1])


def test_several_things_wrong_at_once_are_told_together(made_suite):
    crash, accepted = Answer(None, trouble="crash"), Answer(0)
    wrong = {"core-example#0": crash, "core-example#1": crash, "core-example#3": crash}
    wrong |= {"trailing-byte#0": accepted, "crc-of-a-packet#0": Answer(4)}
    crashes = dict.fromkeys(("core-example#0", "core-example#1", "core-example#3"), "crash")
    fingerprints = {
        "dies": Fingerprint("dies of it", crashes | {"crc-of-a-packet#1": "crash"}, {}),
        "dies-once": Fingerprint("dies once", {"core-example#0": "crash"}, {}),
        "more": Fingerprint("takes more", {"trailing-byte#0": "0:-"}, {}),
        "other": Fingerprint("other", {"trailing-byte#0": "0:-", "critical-chunk#0": "0:-"}, {}),
    }
    found = diagnose(results_of(made_suite, wrong), fingerprints, codes=True)
    assert [one.name for one in found.together] == ["dies", "more"]
    assert (found.n_explained, found.n_wrong) == (4, 5)
    text = found.sentences()
    assert "explain 4 of 5 wrong runs" in text[-3]
    assert text[-1].startswith("    more: takes more; first seen: trailing-byte#0")
