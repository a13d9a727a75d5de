//! Whose damage is diagnosed.

use std::collections::BTreeMap;

use dappo_learn::error::{LearnError, Result};
use dappo_sim::DamageSpace;
use serde::{Deserialize, Serialize};

/// A robot and its damage classes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subject {
    /// Name of the robot.
    pub robot: String,
    /// Names of the damage classes, C of them.
    pub class_names: Vec<String>,
    /// Their damage codes, zeros and ones, `[C, code_length]`.
    pub codes: Vec<Vec<u8>>,
}

impl Subject {
    /// The classes of a damage space.
    #[must_use]
    pub fn new(robot: &str, space: &DamageSpace) -> Self {
        let (limbs, types) = (space.limbs(), space.types().len());
        let code = |code: Vec<f32>| code.into_iter().map(|bit| u8::from(bit > 0.5)).collect();
        Self {
            robot: robot.to_owned(),
            class_names: space.classes().iter().map(|class| class.name.clone()).collect(),
            codes: space.classes().iter().map(|class| code(class.code(limbs, types))).collect(),
        }
    }

    /// Number of damage classes, C.
    #[must_use]
    pub fn classes(&self) -> usize {
        self.class_names.len()
    }

    /// The class with this name or number.
    pub fn class(&self, name: &str) -> Result<usize> {
        let by_number = name.parse().ok().filter(|&class: &usize| class < self.classes());
        let by_name = || self.class_names.iter().position(|known| known == name.trim());
        by_number.or_else(by_name).ok_or_else(|| {
            LearnError::Invalid(format!(
                "`{name}` is not a damage class of the data; expected a number from 0 to {} or a name such as `{}`",
                self.classes().saturating_sub(1),
                self.class_names.last().map_or("healthy", String::as_str)
            ))
        })
    }

    /// Length of a damage code.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.codes.first().map_or(0, Vec::len)
    }

    /// Fails unless every class has a name and a code of its own, and all codes have one length.
    pub fn check(&self) -> Result<()> {
        let (classes, length) = (self.classes(), self.code_length());
        if classes == 0 || self.codes.len() != classes {
            return Err(LearnError::Invalid(format!(
                "there are {classes} names and {} damage codes of classes, expected one of either a class",
                self.codes.len()
            )));
        }
        let mut seen = BTreeMap::new();
        for (class, code) in self.codes.iter().enumerate() {
            let name = &self.class_names[class];
            if code.len() != length || length == 0 || code.iter().any(|&bit| bit > 1) {
                return Err(LearnError::Invalid(format!(
                    "the damage code of class `{name}` is {code:?}, expected {} zeros and ones",
                    length.max(1)
                )));
            }
            if let Some(other) = seen.insert(code.as_slice(), class) {
                return Err(LearnError::Invalid(format!(
                    "classes `{}` and `{name}` have the same damage code",
                    self.class_names[other]
                )));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_limbs() -> Subject {
        let types = vec!["jammed_joint".to_owned(), "missing_toe".to_owned()];
        Subject::new("biped", &DamageSpace::new(2, types, 1).unwrap())
    }

    #[test]
    fn every_class_of_a_space_has_its_name_and_code() {
        let subject = two_limbs();
        subject.check().unwrap();
        assert_eq!((subject.classes(), subject.code_length()), (5, 4));
        assert_eq!(subject.class_names[2], "missing_toe@0");
        assert_eq!(subject.codes[0], [0, 0, 0, 0]);
        assert_eq!(subject.codes[2], [0, 1, 0, 0]);
    }

    #[test]
    fn classes_are_found_by_name_and_by_number() {
        let subject = two_limbs();
        assert_eq!(subject.class("healthy").unwrap(), 0);
        assert_eq!(subject.class(" missing_toe@0").unwrap(), 2);
        assert_eq!(subject.class("4").unwrap(), 4);
        for name in ["5", "-1", "toe", ""] {
            let message = subject.class(name).unwrap_err().to_string();
            assert!(message.contains("from 0 to 4 or a name such as `missing_toe@1`"), "{message}");
        }
    }

    #[test]
    fn tables_that_do_not_tell_classes_apart_are_rejected() {
        let refuse = |change: fn(&mut Subject)| {
            let mut subject = two_limbs();
            change(&mut subject);
            subject.check().unwrap_err().to_string()
        };
        assert!(refuse(|subject| _ = subject.codes.pop()).contains("5 names and 4 damage codes"));
        assert!(refuse(|subject| subject.codes[1].clear()).contains("expected 4 zeros and ones"));
        assert!(refuse(|subject| subject.codes[1][0] = 2).contains("`jammed_joint@0`"));
        assert!(refuse(|subject| subject.codes[3] = vec![0; 4]).contains("the same damage code"));
    }
}
