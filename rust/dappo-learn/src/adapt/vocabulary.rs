//! What a policy can be told about a robot whose damage it may never have been trained with.

use dappo_sim::DamageSpace;

/// The damage classes of the robots that walk, in the words of the policy that controls them.
#[derive(Debug, Clone, PartialEq)]
pub struct Vocabulary {
    /// Names of the robots' damage classes.
    pub names: Vec<String>,
    /// For each of them the class of the same name that the policy knows, if there is one.
    pub known: Vec<Option<usize>>,
    /// The damage codes that the policy is to be told; those of unknown damage are that of a healthy robot.
    pub codes: Vec<Vec<f32>>,
    /// Names of the damage classes that the policy knows.
    pub known_names: Vec<String>,
}

impl Vocabulary {
    /// Compares the damage classes of the robots, `real`, with those that the policy was trained with.
    #[must_use]
    pub fn new(known: &DamageSpace, real: &DamageSpace) -> Self {
        let names = |space: &DamageSpace| -> Vec<String> {
            space.classes().iter().map(|class| class.name.clone()).collect()
        };
        let (names, known_names) = (names(real), names(known));
        let same: Vec<Option<usize>> =
            names.iter().map(|name| known_names.iter().position(|known| known == name)).collect();
        let (limbs, types) = (known.limbs(), known.types().len());
        let code = |class: &Option<usize>| known.classes()[class.unwrap_or(0)].code(limbs, types);
        Self { codes: same.iter().map(code).collect(), known: same, names, known_names }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_known_by_its_name_and_unknown_damage_is_told_as_none() {
        let space = |types: &[&str], max| {
            DamageSpace::new(3, types.iter().map(ToString::to_string).collect(), max).unwrap()
        };
        let vocabulary = Vocabulary::new(&space(&["jammed", "missing"], 2), &space(&["missing", "weak"], 1));
        assert_eq!(
            vocabulary.names,
            ["healthy", "missing@0", "weak@0", "missing@1", "weak@1", "missing@2", "weak@2"]
        );
        // The policy's classes: healthy, then jammed and missing of limb 0, of limb 1, …
        assert_eq!(vocabulary.known, [Some(0), Some(2), None, Some(4), None, Some(6), None]);
        assert_eq!(vocabulary.codes[3], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(vocabulary.codes[4], [0.0; 6]);
        assert_eq!(vocabulary.known_names.len(), 1 + 6 + 12);
    }
}
