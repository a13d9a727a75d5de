//! The setting that is most similar to an unknown key.

use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Similarity of names (Jaro–Winkler, 0 to 1) from which on one is suggested for the other.
const SIMILAR: f64 = 0.85;

/// The setting of a type that is nearest to a dotted key that it does not have: the one whose name is spelt most alike,
/// in whatever section; of several the one in the fewest sections, and in the most similar one.
pub(super) fn nearest<T: DeserializeOwned>(key: &str) -> Option<String> {
    let mut settings = Vec::new();
    collect::<T>("", &mut settings);
    let rated = settings.into_iter().map(|setting| {
        let name = strsim::jaro_winkler(last(key), last(&setting));
        let sections = setting.matches('.').count();
        ((name, std::cmp::Reverse(sections), strsim::jaro_winkler(key, &setting)), setting)
    });
    let best = rated.max_by(|(one, _), (other, _)| {
        one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)).then(one.2.total_cmp(&other.2))
    });
    best.filter(|((name, ..), _)| *name >= SIMILAR).map(|(_, setting)| setting)
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Adds the dotted keys of a section, and those of the sections below it. The type lists them where it
/// refuses one.
fn collect<T: DeserializeOwned>(section: &str, settings: &mut Vec<String>) {
    const NONE: &str = "?";
    let parts: Vec<&str> = section.split('.').filter(|part| !part.is_empty()).collect();
    let inner = Table::from_iter([(NONE.to_owned(), Value::Integer(0))]);
    let table = parts
        .iter()
        .rev()
        .fold(inner, |inner, part| Table::from_iter([((*part).to_owned(), Value::Table(inner))]));
    let refusal = table.try_into::<T>().err().map(|error| error.message().to_owned());
    let expected = refusal.as_deref().and_then(|text| text.strip_prefix("unknown field `?`, expected "));
    for name in expected.unwrap_or_default().split('`').skip(1).step_by(2) {
        let key = if section.is_empty() { name.to_owned() } else { format!("{section}.{name}") };
        let before = settings.len();
        collect::<T>(&key, settings);
        if settings.len() == before {
            settings.push(key);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn a_setting_of_another_section_or_of_like_spelling_is_suggested_and_nothing_for_what_is_unlike_all() {
        for (key, expected) in [
            ("num_envs", Some("env.num_envs")),
            ("env.seed", Some("seed")),
            ("threads", Some("env.threads")),
            ("sead", Some("seed")),
            ("ppo.gama", Some("ppo.gamma")),
            ("ppo.learning_rat", Some("ppo.learning_rate")),
            ("total_step", Some("total_steps")),
            ("xyzzy", None),
        ] {
            assert_eq!(nearest::<Config>(key).as_deref(), expected, "{key}");
        }
    }
}
