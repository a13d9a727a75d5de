//! The tree of Python exceptions and how Rust errors map onto it.
//!
//! `DappoError` > `ConfigError` (also a `ValueError`), `ShapeError` (also a `ValueError`),
//! `SimulationError` (also a `RuntimeError`), `CheckpointError` (also a `RuntimeError`).

use dappo_learn::LearnError;
use dappo_nn::NnError;
use dappo_sim::SimError;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple, PyType};

struct Tree {
    base: Py<PyType>,
    /// In the order of `Kind`.
    kinds: [Py<PyType>; 4],
}

static TREE: PyOnceLock<Tree> = PyOnceLock::new();

/// Which exception an error becomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Bad input.
    Config,
    /// An array of the wrong shape or dtype.
    Shape,
    /// The simulation cannot continue.
    Simulation,
    /// A run folder, checkpoint or dataset cannot be read or written.
    Checkpoint,
}

impl Tree {
    fn of(&self, kind: Kind) -> &Py<PyType> {
        &self.kinds[kind as usize]
    }
}

fn new_type<'py>(
    py: Python<'py>,
    name: &str,
    doc: &str,
    bases: &[&Bound<'py, PyType>],
) -> PyResult<Bound<'py, PyType>> {
    let members = PyDict::new(py);
    members.set_item("__module__", "dappo_batch")?;
    members.set_item("__doc__", doc)?;
    let made = py.get_type::<PyType>().call1((name, PyTuple::new(py, bases)?, members))?;
    Ok(made.cast_into::<PyType>()?)
}

fn tree(py: Python<'_>) -> PyResult<&Tree> {
    TREE.get_or_try_init(py, || {
        let (value, runtime) = (py.get_type::<PyValueError>(), py.get_type::<PyRuntimeError>());
        let exception = py.get_type::<PyException>();
        let base = new_type(py, "DappoError", "Base of all errors of dappo-batch.", &[&exception])?;
        let under = |name, doc, second| new_type(py, name, doc, &[&base, second]).map(Bound::unbind);
        let kinds = [
            under("ConfigError", "An option, robot file or damage specification cannot be used.", &value)?,
            under("ShapeError", "An array has the wrong shape or dtype.", &value)?,
            under("SimulationError", "The simulation cannot continue.", &runtime)?,
            under("CheckpointError", "A run folder or checkpoint cannot be used.", &runtime)?,
        ];
        Ok::<_, PyErr>(Tree { kinds, base: base.unbind() })
    })
}

/// Adds the exception types to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let tree = tree(py)?;
    std::iter::once(&tree.base)
        .chain(&tree.kinds)
        .map(|exception| exception.bind(py))
        .try_for_each(|exception| module.add(exception.name()?, exception))
}

/// An exception of the tree.
pub fn raise(kind: Kind, message: impl Into<String>) -> PyErr {
    let message = message.into();
    Python::attach(|py| match tree(py) {
        Err(error) => error,
        Ok(tree) => PyErr::from_type(tree.of(kind).bind(py).clone(), message),
    })
}

/// Results of the other crates, whose errors become Python exceptions.
pub trait OrRaise<T> {
    /// The value, or the exception.
    fn or_raise(self) -> PyResult<T>;
}

impl<T> OrRaise<T> for Result<T, LearnError> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| from_learn(&error))
    }
}

impl<T> OrRaise<T> for Result<T, NnError> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| raise(nn_kind(&error), error.to_string()))
    }
}

impl<T> OrRaise<T> for Result<T, SimError> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| from_sim(&error))
    }
}

/// A simulation error as a Python exception.
fn from_sim(error: &SimError) -> PyErr {
    let kind = match error {
        SimError::Config(_)
        | SimError::Unsupported(_)
        | SimError::NonFiniteAction { .. }
        | SimError::Memory { .. } => Kind::Config,
        SimError::Shape { .. } => Kind::Shape,
        SimError::Library { .. } | SimError::Threads { .. } | SimError::Device(_) => Kind::Simulation,
        SimError::Snapshot(_) => Kind::Checkpoint,
        SimError::Interrupted => return PyKeyboardInterrupt::new_err(()),
    };
    raise(kind, error.to_string())
}

/// A learner's error as a Python exception.
fn from_learn(error: &LearnError) -> PyErr {
    let kind = match error {
        LearnError::Sim(error) => return from_sim(error),
        LearnError::Nn(error) => nn_kind(error),
        LearnError::Config { .. } | LearnError::Settings(_) | LearnError::Invalid(_) => Kind::Config,
        LearnError::Diverged { .. } => Kind::Simulation,
        LearnError::Unusable { .. } | LearnError::Io { .. } => Kind::Checkpoint,
    };
    raise(kind, error.to_string())
}

fn nn_kind(error: &NnError) -> Kind {
    match error {
        NnError::Config { .. } | NnError::Invalid(_) => Kind::Config,
        NnError::Length { .. } => Kind::Shape,
        NnError::NonFinite { .. } | NnError::Tensor { .. } => Kind::Simulation,
        NnError::Record(_) => Kind::Checkpoint,
    }
}

/// The reverse: an exception of Python code as an error of a simulation.
pub fn to_sim(py: Python<'_>, error: &PyErr) -> SimError {
    // Ctrl-C while Python code runs becomes an exception there.
    if error.is_instance_of::<PyKeyboardInterrupt>(py) {
        return SimError::Interrupted;
    }
    let message = error.value(py).to_string();
    let is_simulation = tree(py).is_ok_and(|tree| error.is_instance(py, tree.of(Kind::Simulation).bind(py)));
    if is_simulation { SimError::Device(message) } else { SimError::Config(message) }
}

/// Whether an exception belongs to the tree.
pub fn is_ours(py: Python<'_>, error: &PyErr) -> bool {
    tree(py).is_ok_and(|tree| error.is_instance(py, tree.base.bind(py)))
}
