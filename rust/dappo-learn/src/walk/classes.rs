//! The damage codes of robots whose damage the policy may never have been trained with.

use dappo_sim::DamageSpace;

/// The damage classes of the robots that walk, and the ones of the policy that they are.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownClasses {
    /// Names of the robots' damage classes.
    pub names: Vec<String>,
    /// For each of them the class of the same name that the policy was trained with, if there is one.
    pub known: Vec<Option<usize>>,
    /// The damage code of each of them; that of unknown damage is the one of a healthy robot.
    pub codes: Vec<Vec<f32>>,
    /// Names of the damage classes that the policy was trained with.
    pub known_names: Vec<String>,
}

impl KnownClasses {
    /// The damage classes that a policy was trained with, of robots with the same.
    #[must_use]
    pub fn of(space: &DamageSpace) -> Self {
        Self::new(space, space)
    }

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
    fn damage_is_known_by_its_name_and_unknown_damage_has_the_code_of_none() {
        let space = |types: &[&str], max| {
            DamageSpace::new(3, types.iter().map(ToString::to_string).collect(), max).unwrap()
        };
        let classes = KnownClasses::new(&space(&["jammed", "missing"], 2), &space(&["missing", "weak"], 1));
        assert_eq!(
            classes.names,
            ["healthy", "missing@0", "weak@0", "missing@1", "weak@1", "missing@2", "weak@2"]
        );
        // The policy's classes: healthy, then jammed and missing of limb 0, of limb 1, …
        assert_eq!(classes.known, [Some(0), Some(2), None, Some(4), None, Some(6), None]);
        assert_eq!(classes.codes[3], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(classes.codes[4], [0.0; 6]);
        assert_eq!(classes.known_names.len(), 1 + 6 + 12);
    }
}
