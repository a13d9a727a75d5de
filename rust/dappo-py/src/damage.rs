//! `DamageSpace` and `DamageClass` in Python.

use dappo_sim::damage::{DamageClass, DamageSpace};
use pyo3::prelude::*;
use pyo3::types::{PySequence, PyString};

use crate::arguments::argument;
use crate::errors::{Kind, OrRaise, raise};

/// One damage class: which limbs are damaged, and how.
#[pyclass(name = "DamageClass", module = "dappo_batch", frozen)]
#[derive(Clone)]
pub struct PyDamageClass {
    class: DamageClass,
    code: Vec<u8>,
    damages: Vec<(usize, String)>,
}

#[pymethods]
impl PyDamageClass {
    /// Position in the canonical order; 0 is healthy.
    #[getter]
    fn id(&self) -> usize {
        self.class.id
    }

    /// `healthy` or for example `jammed_joint@0+missing_toe@2`.
    #[getter]
    fn name(&self) -> &str {
        &self.class.name
    }

    /// Group by number of damages, types and ring distance.
    #[getter]
    fn group(&self) -> &str {
        &self.class.group
    }

    /// The damage code, one bit for every (limb, type).
    #[getter]
    fn code(&self) -> Vec<u32> {
        self.code.iter().map(|&bit| u32::from(bit)).collect()
    }

    /// Pairs (limb, damage type) in ascending order of limb, then type.
    #[getter]
    fn damages(&self) -> Vec<(usize, String)> {
        self.damages.clone()
    }

    fn __repr__(&self) -> String {
        format!("DamageClass(id={}, name='{}', group='{}')", self.class.id, self.class.name, self.class.group)
    }
}

/// The entries of a sequence, each of which must be `one`. They are read one by one: a sequence may claim to be longer than
/// any memory.
fn entries<'py, T>(given: &Bound<'py, PyAny>, what: &str, one: &str) -> PyResult<Vec<T>>
where
    T: for<'a> FromPyObject<'a, 'py>,
{
    if given.is_instance_of::<PyString>() || given.cast::<PySequence>().is_err() {
        return argument(given, what, &format!("a sequence, each entry {one}"));
    }
    let mut entries = Vec::new();
    for entry in given.try_iter()? {
        entries.push(argument(&entry?, &format!("an entry of {what}"), one)?);
    }
    Ok(entries)
}

/// All damage classes of a robot in canonical order.
#[pyclass(name = "DamageSpace", module = "dappo_batch", frozen)]
pub struct PyDamageSpace {
    /// The space in Rust.
    pub inner: DamageSpace,
}

#[pymethods]
impl PyDamageSpace {
    #[new]
    #[pyo3(signature = (limbs, types, max_damaged_limbs, max_damages_per_limb=None))]
    fn new(
        limbs: &Bound<'_, PyAny>,
        types: &Bound<'_, PyAny>,
        max_damaged_limbs: &Bound<'_, PyAny>,
        max_damages_per_limb: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let number = "a whole number of at least 0";
        let limbs = argument(limbs, "limbs", number)?;
        let types = entries(types, "types", "a name")?;
        let max_damaged_limbs = argument(max_damaged_limbs, "max_damaged_limbs", number)?;
        let per_limb =
            max_damages_per_limb.map_or(Ok(1), |most| argument(most, "max_damages_per_limb", number))?;
        DamageSpace::with_damages_per_limb(limbs, types, max_damaged_limbs, per_limb)
            .map(|inner| Self { inner })
            .or_raise()
    }

    /// Number of limbs.
    #[getter]
    fn limbs(&self) -> usize {
        self.inner.limbs()
    }

    /// Names of the damage types.
    #[getter]
    fn types(&self) -> Vec<String> {
        self.inner.types().to_vec()
    }

    /// Largest number of damaged limbs.
    #[getter]
    fn max_damaged_limbs(&self) -> usize {
        self.inner.max_damaged_limbs()
    }

    /// Largest number of damages of a limb.
    #[getter]
    fn max_damages_per_limb(&self) -> usize {
        self.inner.max_damages_per_limb()
    }

    /// Length of a damage code.
    #[getter]
    fn code_length(&self) -> usize {
        self.inner.code_length()
    }

    /// All classes; the index is the class id.
    #[getter]
    fn classes(&self) -> Vec<PyDamageClass> {
        let (limbs, types) = (self.inner.limbs(), self.inner.types());
        let describe = |class: &DamageClass| PyDamageClass {
            code: class.code(limbs, types.len()).iter().map(|&bit| u8::from(bit > 0.0)).collect(),
            damages: class.damages.iter().map(|d| (d.limb, types[d.kind].clone())).collect(),
            class: class.clone(),
        };
        self.inner.classes().iter().map(describe).collect()
    }

    /// The class id that a specification or an id names.
    fn parse(&self, spec: &Bound<'_, PyAny>) -> PyResult<usize> {
        let expected = "a class id, or the name of a damage class";
        let text = match argument::<i64>(spec, "a damage", expected) {
            Ok(id) => id.to_string(),
            Err(_) => argument(spec, "a damage", expected)?,
        };
        self.inner.parse(&text).or_raise()
    }

    /// The id of the class with the same damages of other limbs: `limbs` has the limb that takes the place of each one.
    fn mirror_image(&self, spec: &Bound<'_, PyAny>, limbs: &Bound<'_, PyAny>) -> PyResult<usize> {
        let limbs: Vec<usize> = entries(limbs, "limbs", "a limb")?;
        let class = &self.inner.classes()[self.parse(spec)?];
        let image = self.inner.mirror_image(class, &limbs);
        image.map(|image| image.id).ok_or_else(|| {
            let (count, name) = (self.inner.limbs(), &class.name);
            raise(
                Kind::Config,
                format!("limbs {limbs:?} are no order of {count} limbs; {name} has no mirror image"),
            )
        })
    }

    fn __len__(&self) -> usize {
        self.inner.classes().len()
    }

    fn __repr__(&self) -> String {
        format!(
            "DamageSpace(limbs={}, types={:?}, max_damaged_limbs={}): {} classes",
            self.inner.limbs(),
            self.inner.types(),
            self.inner.max_damaged_limbs(),
            self.inner.classes().len()
        )
    }
}
