//! Bad requests that are too long for a table, or are not text.

use jostle_proto::ErrorCode::{self, InvalidArgument, NotFound, ResourceExhausted};
use jostle_proto::keys;

use crate::support::bad_requests::BadRequest;
use crate::support::{NODE, PREFIX};

fn bad(verb: &str, payload: impl Into<Vec<u8>>, field: Option<&str>) -> BadRequest {
    let selector = match verb {
        "create" => keys::node_cmd(PREFIX, NODE, verb),
        _ => keys::cmd(PREFIX, "victim", verb),
    };
    BadRequest {
        selector,
        payload: Some(payload.into()),
        code: InvalidArgument,
        field: field.map(ToOwned::to_owned),
    }
}

fn with(code: ErrorCode, bad: BadRequest) -> BadRequest {
    BadRequest { code, ..bad }
}

/// A field's name as an error repeats it.
fn cut(name: &str) -> String {
    let start: String = name.chars().take(100).collect();
    format!("{start}…")
}

/// All of them; the long ones have almost `much` bytes.
pub fn all(much: usize) -> Vec<BadRequest> {
    let mut all = no_text();
    all.extend(deep(much));
    all.extend(long(much));
    all
}

/// Those that have almost `much` bytes, more than a handler reads.
pub fn too_long(much: usize) -> Vec<BadRequest> {
    let long = deep(much).into_iter().chain(long(much));
    let long = long.filter(|bad| bad.payload.as_ref().is_some_and(|it| it.len() > much / 2));
    let rejected = long.map(|bad| BadRequest {
        code: ResourceExhausted,
        field: None,
        ..bad
    });
    rejected.collect()
}

fn no_text() -> Vec<BadRequest> {
    let utf_16: Vec<u8> = "{\"steps\": 1}"
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    let marked = [&[0xff, 0xfe], &utf_16[..]].concat();
    let texts: [&[u8]; 16] = [
        &[0xff],
        &[0x00],
        &[0x1f, 0x8b, 0x08, 0x00],
        b"\0{\"steps\": 1}",
        b"{\"steps\": 1}\0",
        b"{\"steps\"\0: 1}",
        b"\xef\xbb\xbf{\"steps\": 1}",
        &utf_16,
        &marked,
        // Latin 1, an overlong slash, a surrogate, one beyond Unicode, one cut short.
        b"{\"client\": \"M\xfcller\"}",
        b"{\"client\": \"\xc0\xaf\"}",
        b"{\"client\": \"\xed\xa0\x80\"}",
        b"{\"client\": \"\xf4\x90\x80\x80\"}",
        b"{\"client\": \"\xe2\x82\"}",
        // CBOR: an empty map; {"steps": 1}.
        &[0xa0],
        &[0xa1, 0x65, b's', b't', b'e', b'p', b's', 0x01],
    ];
    let mut all: Vec<BadRequest> = texts.iter().map(|text| bad("step", *text, None)).collect();
    // Raw control characters, which JSON does not permit within a string.
    all.push(bad("step", "{\"client\": \"a\u{0}b\"}", None));
    all.push(bad("step", "{\"client\": \"a\u{1b}[2Jb\"}", None));
    // Letters and spaces that look like others.
    all.push(bad("step", "{“steps”: 1}", None));
    all.push(bad("step", "{\"steps\": １}", None));
    all.push(bad("step", "{\"steps\":\u{a0}1}", None));
    all.push(bad("step", "{\"st\u{435}ps\": 1}", Some("st\u{435}ps")));
    all.push(bad("step", "{\"steps\u{200b}\": 1}", Some("steps\u{200b}")));
    all.push(bad("step", "{\"\u{202e}spets\": 1}", Some("\u{202e}spets")));
    all
}

fn deep(much: usize) -> Vec<BadRequest> {
    // Deeper than any stack.
    let (many, fewer) = (much * 2 / 5, much / 7);
    let lists = format!("{}1{}", "[".repeat(many), "]".repeat(many));
    let objects = format!("{}1{}", "{\"a\":".repeat(fewer), "}".repeat(fewer));
    let open = "[".repeat(much);
    let raw = "{\"$serde_json::private::RawValue\":".repeat(much / 50);
    vec![
        bad("step", lists.as_str(), None),
        bad("step", objects.as_str(), Some("a")),
        bad("step", open, None),
        bad("step", "{\"a\":".repeat(fewer), None),
        bad("step", raw, None),
        bad("step", format!("{{\"args\": {lists}}}"), Some("args")),
        bad("step", format!("{{\"args\": {objects}}}"), Some("a")),
        bad("step", format!("{{\"client\": {lists}}}"), Some("client")),
        bad("step", format!("{{\"steps\": {lists}}}"), Some("steps")),
        bad(
            "inform",
            format!("{{\"select\": {{\"ids\": {lists}}}, \"direction\": 0}}"),
            Some("select.ids[0]"),
        ),
        bad(
            "batch",
            format!("{{\"commands\": {lists}}}"),
            Some("commands[0][0]"),
        ),
        bad(
            "batch",
            format!("{{\"commands\": [{{\"verb\": \"set\", \"args\": {objects}}}]}}"),
            Some("commands[0].args.a"),
        ),
        bad(
            "batch",
            format!("{{\"commands\": [{{\"args\": {objects}, \"verb\": \"set\"}}]}}"),
            Some(&cut(&format!("commands[0].args{}", ".a".repeat(100)))),
        ),
        bad(
            "create",
            format!("{{\"name\": \"new\", \"spec\": {{\"n\": 1, \"start\": {objects}}}}}"),
            Some(&cut(&format!("spec.start{}", ".a".repeat(100)))),
        ),
    ]
}

fn long(much: usize) -> Vec<BadRequest> {
    // The rest of the request needs a few bytes too.
    let much = much - 200;
    let letters = "x".repeat(much);
    let names: String = (0..much / 12).map(|k| format!("\"f{k}\":1,")).collect();
    let twice = "\"steps\":1,".repeat(much / 12);
    let ones = "1,".repeat(much / 3);
    let poses = "{\"x\":50,\"y\":0,\"alpha\":0},".repeat(much / 26);
    let few = "{\"x\":50,\"y\":0,\"alpha\":0},".repeat(1_000);
    let change = "{\"verb\":\"set\",\"args\":{\"pi3\":1}},";
    let column = format!("[{}0]", "0,".repeat(much / 8));
    let word = "x".repeat(5000);
    let unknown = [
        keys::cmd(PREFIX, "victim", &word),
        keys::get(PREFIX, "victim", &word),
        keys::node_cmd(PREFIX, NODE, &word),
    ];
    let mut long: Vec<BadRequest> = unknown
        .into_iter()
        .map(|selector| BadRequest {
            selector,
            payload: None,
            code: NotFound,
            field: None,
        })
        .collect();
    long.extend([
        bad("step", format!("\"{letters}\""), None),
        bad("step", format!("\"{}\"", "\u{7f}".repeat(much)), None),
        bad("step", format!("{letters}{{}}"), None),
        bad("step", format!("{{}}{letters}"), None),
        bad(
            "step",
            format!("{{\"{letters}\": 1}}"),
            Some(&cut(&letters)),
        ),
        bad(
            "step",
            format!("{{\"{}\": 1}}", "\u{202e}".repeat(much / 4)),
            Some(&cut(&"\u{202e}".repeat(much / 4))),
        ),
        bad(
            "step",
            format!("{{\"client\": \"{}\"}}", "x".repeat(257)),
            Some("client"),
        ),
        bad(
            "step",
            format!("{{\"client\": \"{}\"}}", "x".repeat(5000)),
            Some("client"),
        ),
        bad(
            "step",
            format!("{{\"client\": \"{letters}\"}}"),
            Some("client"),
        ),
        bad(
            "step",
            format!("{{\"request_id\": \"{letters}\"}}"),
            Some("request_id"),
        ),
        bad(
            "step",
            format!("{{\"request_id\": \"{}\"}}", "é".repeat(129)),
            Some("request_id"),
        ),
        bad(
            "step",
            format!("{{\"return\": \"{letters}\"}}"),
            Some("return"),
        ),
        bad(
            "step",
            format!("{{\"steps\": {}}}", "9".repeat(much)),
            Some("steps"),
        ),
        bad(
            "step",
            format!("{{\"steps\": 0.{}}}", "0".repeat(much)),
            Some("steps"),
        ),
        bad(
            "step",
            format!("{{\"timeout_secs\": -{}}}", "1".repeat(much)),
            Some("timeout_secs"),
        ),
        bad("step", format!("{{{names}\"steps\": 1}}"), Some("f0")),
        bad("step", format!("{{{twice}\"steps\": 1}}"), Some("steps")),
        bad(
            "step",
            format!("{{\"args\": {{{twice}\"steps\": 1}}}}"),
            Some("steps"),
        ),
        bad("step", format!("{{\"args\": [{ones}1]}}"), Some("args")),
        bad(
            "inform",
            format!("{{\"select\": {{\"ids\": [{ones}1]}}, \"direction\": 0}}"),
            Some("select.ids"),
        ),
        bad(
            "inform",
            format!("{{\"select\": {{\"{letters}\": 1}}, \"direction\": 0}}"),
            Some("select"),
        ),
        with(
            ResourceExhausted,
            bad(
                "inject",
                format!("{{\"at\": [{}]}}", poses.trim_end_matches(',')),
                Some("n"),
            ),
        ),
        bad(
            "inject",
            format!("{{\"at\": [{}]}}", few.trim_end_matches(',')),
            Some("at[1]"),
        ),
        bad(
            "batch",
            format!(
                "{{\"commands\": [{}]}}",
                change.repeat(257).trim_end_matches(',')
            ),
            Some("commands"),
        ),
        bad(
            "batch",
            format!(
                "{{\"commands\": [{}]}}",
                change.repeat(much / 40).trim_end_matches(',')
            ),
            Some("commands"),
        ),
        bad(
            "batch",
            format!("{{\"commands\": [{ones}1]}}"),
            Some("commands[0]"),
        ),
        bad(
            "create",
            format!(
                "{{\"name\": \"{}\", \"spec\": {{\"n\": 1}}}}",
                "x".repeat(65)
            ),
            Some("name"),
        ),
        bad(
            "create",
            format!("{{\"name\": \"{letters}\", \"spec\": {{\"n\": 1}}}}"),
            Some("name"),
        ),
        bad(
            "create",
            format!(
                "{{\"name\": \"new\", \"spec\": {{\"n\": 1, \"start\": {{\"kind\": \"{letters}\"}}}}}}"
            ),
            Some("spec.start.kind"),
        ),
        bad(
            "create",
            format!(
                "{{\"name\": \"new\", \"spec\": {{\"n\": 3, \"start\": {{\"kind\": \"given\", \"x\": {column}, \"y\": {column}, \"alpha\": {column}}}}}}}"
            ),
            Some("spec.start.x"),
        ),
        bad(
            "create",
            format!(
                "{{\"name\": \"new\", \"spec\": {{\"n\": 150000, \"start\": {{\"kind\": \"given\", \"x\": {column}, \"y\": {column}, \"alpha\": {column}}}}}}}"
            ),
            Some("spec.n"),
        ),
    ]);
    long
}
