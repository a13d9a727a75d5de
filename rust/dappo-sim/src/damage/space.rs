//! All damage classes of a robot in canonical order, and the specifications that name them.

use super::class::{Damage, DamageClass, group};
use crate::error::SimError;

/// The classes of `limbs` limbs with at most `max_damaged_limbs` of them damaged, each by at most `max_damages_per_limb`
/// different types.
///
/// Canonical order: number of damages, then limbs (lexicographic), then types (lexicographic).
#[derive(Debug, Clone)]
pub struct DamageSpace {
    limbs: usize,
    types: Vec<String>,
    max_damaged_limbs: usize,
    max_damages_per_limb: usize,
    classes: Vec<DamageClass>,
}

/// A guard against a mistyped parameter, not a limit of the method: each class is a compiled model.
const MAX_CLASSES: u128 = 100_000;
/// The same for limbs × types.
const MAX_CODE_LENGTH: usize = 4096;

impl DamageSpace {
    /// Enumerates the classes with at most one damage a limb.
    pub fn new(limbs: usize, types: Vec<String>, max_damaged_limbs: usize) -> Result<Self, SimError> {
        Self::with_damages_per_limb(limbs, types, max_damaged_limbs, 1)
    }

    /// Enumerates the classes.
    pub fn with_damages_per_limb(
        limbs: usize,
        types: Vec<String>,
        max_damaged_limbs: usize,
        max_damages_per_limb: usize,
    ) -> Result<Self, SimError> {
        if limbs == 0 {
            return Err(SimError::Config("a robot needs at least one limb, got 0".into()));
        }
        if max_damaged_limbs > limbs {
            return Err(SimError::Config(format!(
                "max_damaged_limbs is {max_damaged_limbs}, but the robot has {limbs} limbs"
            )));
        }
        if max_damaged_limbs > 0 && types.is_empty() {
            return Err(SimError::Config(
                "max_damaged_limbs is above 0, but there are no damage types".into(),
            ));
        }
        for (index, name) in types.iter().enumerate() {
            if types[..index].contains(name) {
                return Err(SimError::Config(format!("damage type `{name}` is listed twice")));
            }
        }
        if max_damages_per_limb == 0 {
            return Err(SimError::Config("max_damages_per_limb must be at least 1, got 0".into()));
        }
        if max_damages_per_limb > types.len().max(1) {
            return Err(SimError::Config(format!(
                "max_damages_per_limb is {max_damages_per_limb}, but there are {} damage types, and a limb has each once",
                types.len()
            )));
        }
        if limbs.saturating_mul(types.len().max(1)) > MAX_CODE_LENGTH {
            return Err(SimError::Config(format!(
                "{limbs} limbs and {} damage types make a damage code of more than {MAX_CODE_LENGTH} bits",
                types.len()
            )));
        }
        let count = count_classes(limbs, types.len(), max_damaged_limbs, max_damages_per_limb);
        if count > MAX_CLASSES {
            return Err(SimError::Config(format!(
                "{limbs} limbs, {} damage types and up to {max_damaged_limbs} damaged limbs make {count} classes or more, \
                 at most {MAX_CLASSES} are possible",
                types.len()
            )));
        }
        let classes = Vec::with_capacity(count as usize);
        let mut space = Self { limbs, types, max_damaged_limbs, max_damages_per_limb, classes };
        for size in 0..=max_damaged_limbs * max_damages_per_limb {
            for chosen in limb_lists(limbs, size, max_damaged_limbs, max_damages_per_limb) {
                for kinds in type_lists(&chosen, space.types.len()) {
                    let damages =
                        chosen.iter().zip(&kinds).map(|(&limb, &kind)| Damage { limb, kind }).collect();
                    space.push(damages);
                }
            }
        }
        Ok(space)
    }

    fn push(&mut self, damages: Vec<Damage>) {
        let name = if damages.is_empty() {
            "healthy".to_owned()
        } else {
            damages.iter().map(|d| format!("{}@{}", self.types[d.kind], d.limb)).collect::<Vec<_>>().join("+")
        };
        let group = group(&damages, self.limbs);
        self.classes.push(DamageClass { id: self.classes.len(), damages, name, group });
    }

    /// Number of limbs.
    #[must_use]
    pub fn limbs(&self) -> usize {
        self.limbs
    }

    /// Names of the damage types.
    #[must_use]
    pub fn types(&self) -> &[String] {
        &self.types
    }

    /// Largest number of damaged limbs.
    #[must_use]
    pub fn max_damaged_limbs(&self) -> usize {
        self.max_damaged_limbs
    }

    /// Largest number of damages of a limb.
    #[must_use]
    pub fn max_damages_per_limb(&self) -> usize {
        self.max_damages_per_limb
    }

    /// All classes; the index is the class id.
    #[must_use]
    pub fn classes(&self) -> &[DamageClass] {
        &self.classes
    }

    /// Length of a damage code: limbs × types.
    #[must_use]
    pub fn code_length(&self) -> usize {
        self.limbs * self.types.len()
    }

    /// The codes of all classes, row by row.
    ///
    /// # Shapes
    /// - output: `[classes, code_length]`
    #[must_use]
    pub fn codes(&self) -> Vec<f32> {
        self.classes.iter().flat_map(|class| class.code(self.limbs, self.types.len())).collect()
    }

    /// The class with the same damages of other limbs: `images` has the limb that takes the place of each one, as in
    /// [`MirroredParts::limbs`](crate::task::MirroredParts::limbs).
    #[must_use]
    pub fn mirror_image(&self, class: &DamageClass, images: &[usize]) -> Option<&DamageClass> {
        let image = |damage: &Damage| Some(Damage { limb: *images.get(damage.limb)?, ..*damage });
        let mut damages = class.damages.iter().map(image).collect::<Option<Vec<_>>>()?;
        damages.sort_unstable();
        self.classes.iter().find(|class| class.damages == damages)
    }

    /// The class that a specification names: `healthy`, `jammed_joint@0`,
    /// `missing_toe@1+jammed_joint@3` (any order) or a class id.
    pub fn parse(&self, spec: &str) -> Result<usize, SimError> {
        let text = spec.trim();
        if let Ok(id) = text.parse::<usize>() {
            return if id < self.classes.len() {
                Ok(id)
            } else {
                Err(SimError::Config(format!(
                    "damage class {id} does not exist; the classes are 0 to {}",
                    self.classes.len() - 1
                )))
            };
        }
        let mut damages = Vec::new();
        if text != "healthy" {
            for part in text.split('+') {
                damages.push(self.parse_damage(part.trim(), spec)?);
            }
        }
        damages.sort_unstable();
        if let Some(pair) = damages.windows(2).find(|pair| pair[0] == pair[1]) {
            let Damage { limb, kind } = pair[0];
            return Err(SimError::Config(format!("`{spec}` lists `{}@{limb}` twice", self.types[kind])));
        }
        let of_limbs: Vec<_> = damages.chunk_by(|one, other| one.limb == other.limb).collect();
        let most = self.max_damages_per_limb;
        if let Some(many) = of_limbs.iter().find(|damages| damages.len() > most) {
            return Err(SimError::Config(format!(
                "`{spec}` has {} damages of limb {}; a limb has at most {most}, see max_damages_per_limb",
                many.len(),
                many[0].limb
            )));
        }
        self.classes.iter().find(|class| class.damages == damages).map(|class| class.id).ok_or_else(|| {
            SimError::Config(format!(
                "`{spec}` damages {} limbs, the class table holds at most {}",
                of_limbs.len(),
                self.max_damaged_limbs
            ))
        })
    }

    fn parse_damage(&self, part: &str, spec: &str) -> Result<Damage, SimError> {
        let bad = |why: String| {
            SimError::Config(format!(
                "cannot read the damage `{spec}`: {why}; write `healthy`, a class id from 0 to {}, or damages like `{}@0` \
                 joined by `+`",
                self.classes.len() - 1,
                self.types.first().map_or("type", String::as_str),
            ))
        };
        let (name, limb) = part.split_once('@').ok_or_else(|| bad(format!("`{part}` has no `@limb`")))?;
        let kind = self.types.iter().position(|known| known == name).ok_or_else(|| {
            bad(format!("`{name}` is not a damage type of this robot (it has {})", self.types.join(", ")))
        })?;
        let limb = limb
            .parse::<usize>()
            .ok()
            .filter(|&limb| limb < self.limbs)
            .ok_or_else(|| bad(format!("`{limb}` is not a limb; limbs are 0 to {}", self.limbs - 1)))?;
        Ok(Damage { limb, kind })
    }
}

/// Σ_{j=0..m} (Σ_{s=1..p} C(k, s))ʲ·C(n, j); for p = 1, one damage a limb, the number of classes in Verma et al. (2019).
fn count_classes(limbs: usize, types: usize, max_damaged: usize, per_limb: usize) -> u128 {
    let mut sets: u128 = 0;
    let mut sets_of_size: u128 = 1;
    for size in 0..per_limb.min(types) {
        sets_of_size = sets_of_size.saturating_mul((types - size) as u128) / (size as u128 + 1);
        sets = sets.saturating_add(sets_of_size);
    }
    let mut term: u128 = 1;
    let mut total: u128 = 1;
    for j in 0..max_damaged {
        term = term.saturating_mul((limbs - j) as u128) / (j as u128 + 1);
        total = total.saturating_add(term.saturating_mul(sets.saturating_pow(j as u32 + 1)));
        if total > MAX_CLASSES {
            break;
        }
    }
    total
}

/// All ascending lists of `size` limbs in lexicographic order, with at most `most` different ones, each at most
/// `per_limb` times.
fn limb_lists(limbs: usize, size: usize, most: usize, per_limb: usize) -> Vec<Vec<usize>> {
    let fits = |list: &[usize]| {
        let mut runs = list.chunk_by(|one, other| one == other);
        runs.clone().count() <= most && runs.all(|run| run.len() <= per_limb)
    };
    let mut all = vec![vec![]];
    for _ in 0..size {
        all = all
            .into_iter()
            .flat_map(|prefix: Vec<usize>| {
                let first = prefix.last().copied().unwrap_or(0);
                (first..limbs).map(move |next| [&prefix[..], &[next]].concat())
            })
            .filter(|list| fits(list))
            .collect();
    }
    all
}

/// All types of the damages of these limbs in lexicographic order; those of one limb ascend.
fn type_lists(limbs: &[usize], types: usize) -> Vec<Vec<usize>> {
    let mut all = vec![vec![]];
    for (index, limb) in limbs.iter().enumerate() {
        let is_repeated = index > 0 && limbs[index - 1] == *limb;
        all = all
            .into_iter()
            .flat_map(|prefix: Vec<usize>| {
                let first = prefix.last().filter(|_| is_repeated).map_or(0, |last| last + 1);
                (first..types).map(move |next| [&prefix[..], &[next]].concat())
            })
            .collect();
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space(limbs: usize, types: usize, max: usize) -> DamageSpace {
        let names = ["jammed_joint", "missing_toe", "weak_motor"];
        DamageSpace::new(limbs, names[..types].iter().map(ToString::to_string).collect(), max).unwrap()
    }

    #[test]
    fn the_number_of_classes_is_that_of_the_paper() {
        let count = |n, k, m| space(n, k, m).classes().len();
        assert_eq!(count(4, 2, 2), 33);
        assert_eq!(count(6, 2, 2), 73);
        assert_eq!(count(6, 2, 3), 233);
        assert_eq!(count(6, 3, 6), 4096);
        assert_eq!(count_classes(6, 3, 6, 1), 4096);
    }

    #[test]
    fn every_class_is_found_by_its_name_and_by_its_id() {
        let space = space(6, 2, 3);
        for class in space.classes() {
            assert_eq!(space.parse(&class.name).unwrap(), class.id);
            assert_eq!(space.parse(&class.id.to_string()).unwrap(), class.id);
        }
        assert_eq!(
            space.parse("missing_toe@3 + jammed_joint@1").unwrap(),
            space.parse("jammed_joint@1+missing_toe@3").unwrap()
        );
    }

    #[test]
    fn mirror_images_have_the_same_damages_of_the_limbs_of_the_other_side() {
        // Limbs 0 and 3, 1 and 2 take each other's place, as those of the Ant: 33 classes, 19 up to symmetry.
        let (space, images) = (space(4, 2, 2), [3, 2, 1, 0]);
        let image = |class: &DamageClass| space.mirror_image(class, &images).unwrap().clone();
        let of = |name: &str| image(&space.classes()[space.parse(name).unwrap()]).name;
        assert_eq!(of("healthy"), "healthy");
        assert_eq!(of("missing_toe@0"), "missing_toe@3");
        assert_eq!(of("missing_toe@0+jammed_joint@2"), "jammed_joint@1+missing_toe@3");
        let own = space.classes().iter().filter(|class| image(class) == **class).count();
        assert_eq!(own, 5, "33 = 2 · 19 - 5");
    }

    #[test]
    fn a_wrong_specification_says_what_is_wrong_and_what_exists() {
        let space = space(4, 2, 2);
        for (spec, part) in [
            ("jam@0", "`jam` is not a damage type"),
            ("jammed_joint@4", "limbs are 0 to 3"),
            ("jammed_joint", "no `@limb`"),
            ("33", "the classes are 0 to 32"),
            ("jammed_joint@0+missing_toe@0", "2 damages of limb 0; a limb has at most 1"),
            ("jammed_joint@0+jammed_joint@0", "lists `jammed_joint@0` twice"),
            ("jammed_joint@0+jammed_joint@1+jammed_joint@2", "at most 2"),
            ("", "no `@limb`"),
        ] {
            let message = space.parse(spec).unwrap_err().to_string();
            assert!(message.contains(part), "`{spec}` gave: {message}");
        }
    }

    #[test]
    fn a_limb_with_several_damages_has_each_set_of_types_once() {
        let types = || ["a", "b", "c"].map(str::to_owned).to_vec();
        let space = DamageSpace::with_damages_per_limb(2, types(), 1, 2).unwrap();
        let names: Vec<&str> = space.classes().iter().map(|class| class.name.as_str()).collect();
        let expected = [
            "healthy", "a@0", "b@0", "c@0", "a@1", "b@1", "c@1", "a@0+b@0", "a@0+c@0", "b@0+c@0", "a@1+b@1",
            "a@1+c@1", "b@1+c@1",
        ];
        assert_eq!(names, expected);
        assert_eq!(space.classes()[7].group, "D1_2 L");
        assert_eq!(space.classes()[8].code(2, 3), [1.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        // (C(3, 1) + C(3, 2) + C(3, 3))ʲ·C(n, j) summed over j: 1 + 7·4 + 7²·6.
        let large = DamageSpace::with_damages_per_limb(4, types(), 2, 3).unwrap();
        assert_eq!(large.classes().len(), 323);
        let mut seen = std::collections::BTreeSet::new();
        for class in large.classes() {
            assert_eq!(large.parse(&class.name).unwrap(), class.id);
            assert!(seen.insert(format!("{:?}", class.code(4, 3))));
        }
        let sizes: Vec<usize> = large.classes().iter().map(|class| class.damages.len()).collect();
        assert!(sizes.is_sorted() && sizes.last() == Some(&6));
        for (limbs, per_limb, part) in [(4, 0, "at least 1"), (4, 4, "there are 3 damage types")] {
            let refused =
                DamageSpace::with_damages_per_limb(limbs, types(), 1, per_limb).unwrap_err().to_string();
            assert!(refused.contains(part), "{refused}");
        }
    }

    #[test]
    fn impossible_spaces_are_rejected() {
        let types = || vec!["jammed_joint".to_owned()];
        assert!(DamageSpace::new(0, types(), 0).is_err());
        assert!(DamageSpace::new(4, types(), 5).is_err());
        assert!(DamageSpace::new(4, vec![], 1).is_err());
        assert!(DamageSpace::new(4, [types(), types()].concat(), 1).is_err());
        assert!(DamageSpace::new(64, types(), 64).is_err());
    }
}
