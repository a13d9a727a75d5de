//! The instruction set of the lane engine and of the networks.

pub use dappo_lanes::Simd;

use crate::error::SimError;

/// Environment variable that selects the instruction set.
const VARIABLE: &str = "DAPPO_SIMD";

/// The fastest instruction set of this processor, or the one selected by the environment variable
/// `DAPPO_SIMD`.
pub fn chosen() -> Result<Simd, SimError> {
    select(selected().as_deref(), VARIABLE)
}

/// All instruction sets of this processor, the fastest first, or the one selected by the environment variable
/// `DAPPO_SIMD`.
pub fn choices() -> Result<Vec<Simd>, SimError> {
    match selected() {
        None => Ok(Simd::available()),
        name => Ok(vec![select(name.as_deref(), VARIABLE)?]),
    }
}

/// What the environment variable selects.
fn selected() -> Option<String> {
    std::env::var(VARIABLE).ok().filter(|name| !name.is_empty())
}

/// The instruction set of this name, or the fastest one; `source` is where the name comes from.
pub fn select(name: Option<&str>, source: &str) -> Result<Simd, SimError> {
    let available = Simd::available();
    let found = match name {
        None => available.first(),
        Some(name) => available.iter().find(|simd| simd.name() == name),
    };
    found.copied().ok_or_else(|| {
        let known: Vec<String> = available.iter().map(|simd| format!("`{}`", simd.name())).collect();
        SimError::Config(format!(
            "{source} is `{}`, but this processor has {}",
            name.unwrap_or_default(),
            known.join(", ")
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fastest_set_is_the_default_and_portable_code_is_always_there() {
        assert_eq!(select(None, "test").unwrap(), Simd::available()[0]);
        assert_eq!(select(Some("portable"), "test").unwrap(), Simd::Portable);
    }

    #[test]
    fn an_unknown_set_is_rejected_with_those_at_hand() {
        let message = select(Some("mmx"), "DAPPO_SIMD").unwrap_err().to_string();
        assert!(message.starts_with("DAPPO_SIMD is `mmx`, but this processor has"), "{message}");
        assert!(message.contains("`portable`"), "{message}");
    }
}
