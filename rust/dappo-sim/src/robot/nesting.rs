//! How deep a TOML is nested, before it is parsed.
//!
//! Values are freed and deserialised by recursion, so a file of a few hundred kilobytes could overflow the stack.

/// Whether brackets or dotted keys nest deeper than `limit`.
pub(super) fn is_deeper_than(text: &str, limit: usize) -> bool {
    let (mut brackets, mut dots) = (0_usize, 0_usize);
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let mut used = first.len_utf8();
        match first {
            '#' => used = rest.find('\n').unwrap_or(rest.len()),
            '"' | '\'' => used = string_length(rest, first),
            '[' | '{' => {
                (brackets, dots) = (brackets + 1, 0);
            }
            ']' | '}' => {
                (brackets, dots) = (brackets.saturating_sub(1), 0);
            }
            '=' | ',' | '\n' => dots = 0,
            '.' => dots += 1,
            _ => {}
        }
        if brackets.max(dots) > limit {
            return true;
        }
        rest = &rest[used..];
    }
    false
}

/// Bytes of the string that `text` begins with, its quotes included; to the end of the line, or of the text for one of
/// several lines, if it is not closed.
fn string_length(text: &str, quote: char) -> usize {
    let triple: String = std::iter::repeat_n(quote, 3).collect();
    let (open, close) = if text.starts_with(&triple) { (3, triple) } else { (1, quote.to_string()) };
    let mut position = open;
    while position < text.len() {
        let rest = &text[position..];
        if rest.starts_with(&close) {
            return position + close.len();
        }
        let mut characters = rest.chars();
        let Some(first) = characters.next() else { break };
        if first == '\n' && open == 1 {
            return position;
        }
        position += first.len_utf8();
        if first == '\\' && quote == '"' {
            position += characters.next().map_or(0, char::len_utf8);
        }
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brackets_and_dotted_keys_nest_and_nothing_else_does() {
        for (text, depth) in [
            ("a = 1.5", 1),
            ("a = [[[1.0, 2.0], [3.0]]]", 3),
            ("[a.b.c]\nd = 0", 2),
            ("a.b.c.d.e = 0", 4),
            ("a = {b = {c.d.e = 1}}", 2),
            ("a = \"[[[[ \\\" ....... \" # [[[[", 0),
            ("a = '[[[['\nb = '''[[[\n[['''", 0),
            ("a = \"not closed [[[\nb = [1]", 1),
            ("a = 1\n\nb = []\nc = []\nd = []", 1),
        ] {
            assert!(!is_deeper_than(text, depth), "{text}");
            assert!(depth == 0 || is_deeper_than(text, depth - 1), "{text}");
        }
    }
}
