"""The XML reader: places, verbatim text, encodings, and what it refuses."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kempe.description.source import MANY_PROBLEMS, SIZE_LIMIT, Findings, Source
from kempe.description.xml import DEPTH_LIMIT, ELEMENT_LIMIT, parse_xml
from kempe.errors import PROBLEM_LIMIT, DescriptionError, Where

TEXT = (
    '<?xml version="1.0"?>\r\n<a é="1" b=\'>/>\'>\n  <c/>text &amp; <d\n x="&lt;"\t>/>\n</d>\r</a>'
)


def test_elements_know_their_places():
    a = parse_xml(TEXT, "f")
    c, d = a.children
    assert [(e.tag, e.location.line, e.location.column) for e in a.iterate_elements()] == [
        ("a", 2, 1),
        ("c", 3, 3),
        ("d", 3, 18),
    ]
    assert a.attributes == {"é": "1", "b": ">/>"} and d.attributes == {"x": "<"}
    assert (d.locate_attribute("x").line, d.locate_attribute("x").column) == (4, 5)
    assert d.locate_attribute("y") == d.location
    assert a.locate_attribute("b") == Where("f", 2, 13, "<a é=\"1\" b='>/>'>")
    assert a.find_children("d") == [d] and a.find_children("e") == []


def test_attributes_are_not_found_in_each_other():
    a = parse_xml("""<a x=" y='1'" y = '2'/>""", "f")
    assert [a.locate_attribute(name).column for name in "xy"] == [7, 20]


def test_text_is_kept_as_written():
    a = parse_xml(TEXT, "f")
    assert a.text == TEXT[TEXT.index("<a") :]
    assert [e.text for e in a.children] == ["<c/>", '<d\n x="&lt;"\t>/>\n</d>']


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le+", "utf-16-be+"])
def test_encodings(encoding: str):
    name, _, marked = encoding.partition("+")
    data = ("\ufeff" * (encoding[-1:] == "+") + TEXT).encode(name)
    a = parse_xml(data, "f")
    assert a.attributes["é"] == "1" and a.children[1].location.line == 3


@pytest.mark.parametrize("declared", ["ISO-8859-1", "latin1", "windows-1252"])
def test_declared_latin(declared: str):
    text = f"<?xml version='1.0' encoding='{declared}'?><a b='é'/>"
    assert parse_xml(text.encode("latin-1"), "f").attributes == {"b": "é"}
    assert parse_xml(text, "f").attributes == {"b": "é"}  # a text is decoded already


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("<a/>".encode("utf-32"), "UTF-32"),
        (
            b'\xef\xbb\xbf<?xml version="1.0" encoding="ISO-8859-1"?><a/>',
            "byte order mark says UTF-8",
        ),
        (
            '\ufeff<?xml version="1.0" encoding="utf-8"?><a/>'.encode("utf-16-le"),
            "byte order mark says UTF-16",
        ),
        ("<a/>".encode("utf-16")[:-1], "ends inside a character of UTF-16"),
        ("<a>é</a>".encode()[:4], "0xc3 is not UTF-8"),
        (b"<a b='1' b='2'/>", "an attribute is given twice"),
        (b"<a/><b/>", "goes on after the end"),
        (b" <?xml version='1.0'?><a/>", "not at the very start"),
        (b"<a>&#0;</a>", "a character that XML forbids"),
        (b"<a>\x01</a>", "not XML"),
        (b"<a", "truncated"),
        (b"<a><!-- ", "truncated"),
        (b"<a><![CDATA[ ", "truncated"),
        (b"<a b='", "truncated"),
        (b"<!DOCTYPE a><a/>", "DTD"),
        (b"<a>" * (DEPTH_LIMIT + 1), f"more than {DEPTH_LIMIT} deep"),
        pytest.param(
            b"<r>" + b"<a/>" * ELEMENT_LIMIT, "more than 1000000 elements", marks=pytest.mark.slow
        ),
        (b" " * (SIZE_LIMIT + 1), "more than 32 MiB"),
        ("<a>\ud800</a>", "surrogate"),
    ],
)
def test_what_is_refused(data, words: str):
    with pytest.raises(DescriptionError, match=words) as caught:
        parse_xml(data, "f.xml")
    (problem,) = caught.value.problems
    assert problem.allowed and str(problem).startswith("f.xml")


@pytest.mark.parametrize("kind", ["x SYSTEM", "% x SYSTEM"])
def test_entities_of_a_file_are_never_opened(kind, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("hunter2")
    text = f'<!DOCTYPE a [<!ENTITY {kind} "{secret.as_uri()}">]><a>&x;</a>'
    with pytest.raises(DescriptionError) as caught:
        parse_xml(text, "f")
    assert "hunter2" not in str(caught.value)


@given(st.binary(max_size=200))
def test_any_bytes(data: bytes):
    try:
        parse_xml(data, "f")
    except DescriptionError as error:
        assert len(error.problems) == 1


@given(st.text(st.sampled_from("ab\r\n\u2028é"), max_size=30))
def test_lines_and_offsets_agree(text: str):
    source = Source("t", text)
    for offset in range(len(text)):
        where = source.locate_offset(offset)
        assert source.compute_offset(where.line, where.column) == offset
    assert "".join(source.lines) == text.replace("\r", "").replace("\n", "")


def test_a_hostile_number_of_problems_ends_the_reading():
    findings = Findings()
    with pytest.raises(DescriptionError) as caught:
        for _ in range(10 * MANY_PROBLEMS):
            with findings.record_errors("a"):
                findings.add_problem("wrong")
    assert len(caught.value.problems) == MANY_PROBLEMS


def test_findings_are_sorted_and_bounded():
    findings = Findings()
    for line in range(30, 0, -1):
        findings.add_problem("wrong", where=Where("f", line), allowed="right")
        findings.add_note("odd", where=Where("f", line))
    assert findings.notes[:2] == ["f:1: odd", "f:2: odd"]
    with pytest.raises(DescriptionError) as caught:
        findings.raise_problems()
    assert len(caught.value.problems) == 30
    assert str(caught.value).splitlines()[0] == "f:1: wrong; right"
    assert str(caught.value).splitlines()[PROBLEM_LIMIT:] == ["... and 10 more"]
    assert findings.suggest_name("x", ["y"]) == ""  # nobody would see it


@pytest.mark.parametrize(
    ("inside", "content"),
    [
        ("", ""),
        (" 1 2\n", "1 2"),
        ("a &lt; &#98;<!-- c > --><![CDATA[<d>]]><?e f?>", "a < b<d>"),
        ("<!-- nothing -->", ""),
    ],
)
def test_text_inside_an_element(inside: str, content: str):
    (element,) = parse_xml(f"<a>\n<b x='>'>{inside}</b></a>", "f").children
    assert element.content == content
    column = 11 if content and inside[0] == " " else 10 if inside.strip() else 1
    assert element.content_location.column == column
    (empty,) = parse_xml("<a><b/></a>", "f").children
    assert empty.content == "" and empty.content_location == empty.location


def test_dashes_in_comments_are_noted():
    text = "<!-- a --b -->\n<a><!-- c --- d--><b/></a>"
    with pytest.raises(DescriptionError, match="not XML"):
        parse_xml(text, "f")
    findings = Findings()
    (b,) = parse_xml(text, "f", findings).children
    assert (b.location.line, b.location.column) == (2, 19)
    assert findings.notes == ["f:1: a comment holds '--', which XML forbids; it is passed over"]
    for wrong in ("<!-- -- --><a>", "<a><b></a>"):
        with pytest.raises(DescriptionError):
            parse_xml(wrong, "f", Findings())
