//! Networks and optimisers as bytes of burnpack files. Such records keep parameter ids, by which Adam's moments find
//! their parameters.
//!
//! Burn takes the types and shapes of a record on trust, and ends the process where they do not fit. So every array is
//! looked at before burn gets it.

use std::collections::{BTreeMap, BTreeSet};

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::ModuleOptimizer;
use burn::store::ModuleRecord;
use burn::tensor::{Bytes, DType, Tensor};
use burn_pack::{Reader, Scalar};

use crate::error::{NnError, Result};

/// What a record needs besides its numbers, at most, bytes.
const OVERHEAD: u64 = 1 << 20;
/// The most steps that Adam's correction of the bias is computed for.
const MOST_STEPS: u64 = i32::MAX as u64;

/// The record of a module.
pub fn module_bytes<M: Module>(module: &M) -> Result<Bytes> {
    module.clone().into_record().into_bytes().map_err(unreadable)
}

/// The record of an optimiser's state.
pub fn optimizer_bytes(optimizer: &ModuleOptimizer) -> Result<Bytes> {
    optimizer.into_bytes().map_err(unreadable)
}

/// The fewest and the most bytes of the record of a module of this many numbers; `None` stands for more than
/// can be counted. What is made from its sizes then takes no more memory than the record itself.
pub fn module_size(numbers: Option<usize>) -> Result<[u64; 2]> {
    let fewest = numbers.and_then(|numbers| (numbers as u64).checked_mul(4));
    let fewest = fewest.ok_or_else(|| unreadable("its sizes are beyond all memory"))?;
    Ok([fewest, fewest.saturating_add(OVERHEAD)])
}

/// The most bytes of the record of an optimiser of this module.
pub fn optimizer_size<M: Module>(module: &M) -> u64 {
    (module.num_params() as u64).saturating_mul(8).saturating_add(OVERHEAD)
}

/// Replaces the parameters of `module` by those of a record.
pub fn load_module<M: Module>(module: M, bytes: Vec<u8>) -> Result<M> {
    let bytes = Bytes::from_bytes_vec(bytes).shared();
    let (arrays, _) = arrays(bytes.clone())?;
    let mut known = BTreeSet::new();
    // Two parameters of one id would share their moments.
    if let Some(array) = arrays.iter().find(|array| array.id.is_some_and(|id| !known.insert(id))) {
        return Err(unreadable(format!("the id of `{}` is that of another array", array.name)));
    }
    ModuleRecord::from_bytes(bytes).and_then(|record| module.try_load_record(record)).map_err(unreadable)
}

/// Replaces the state of `fresh`, an Adam of the same settings, by that of a record. The state is that of the parameters
/// of `module`.
pub fn load_optimizer<M: Module>(
    fresh: ModuleOptimizer,
    module: &M,
    bytes: Vec<u8>,
) -> Result<ModuleOptimizer> {
    let bytes = Bytes::from_bytes_vec(bytes).shared();
    let (arrays, scalars) = arrays(bytes.clone())?;
    check_moments(&parameters(module), arrays, scalars).map_err(unreadable)?;
    fresh.from_bytes(bytes).map_err(unreadable)
}

/// An array of a record.
struct Array {
    name: String,
    id: Option<u64>,
    shape: Vec<usize>,
    is_negative: bool,
}

/// The arrays and scalars of a record, if all its numbers are finite and lie as burn expects them.
fn arrays(bytes: Bytes) -> Result<(Vec<Array>, BTreeMap<String, Scalar>)> {
    let reader = Reader::from_bytes(bytes).map_err(unreadable)?;
    let scalars = reader.scalars().clone();
    let mut arrays = Vec::new();
    for array in reader.into_tensors().map_err(unreadable)? {
        let (name, dtype, shape, id, bytes) = array.into_parts().map_err(unreadable)?;
        if dtype != DType::F32 {
            return Err(unreadable(format!("`{name}` is of type {dtype:?}, expected F32")));
        }
        if !bytes.as_ptr().addr().is_multiple_of(align_of::<f32>()) {
            return Err(unreadable(format!("`{name}` does not begin at a multiple of 4 bytes")));
        }
        let numbers = || bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        if let Some(number) = numbers().find(|number| !number.is_finite()) {
            return Err(unreadable(format!("`{name}` holds {number}, expected finite numbers")));
        }
        let is_negative = numbers().any(|number| number < 0.0);
        arrays.push(Array { name, id, shape: shape.iter().copied().collect(), is_negative });
    }
    Ok((arrays, scalars))
}

/// Ids and shapes of parameters.
struct Parameters(Vec<(u64, Vec<usize>)>);

impl ModuleVisitor for Parameters {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.0.push((param.id.val(), param.lazy_shape().dims::<D>().to_vec()));
    }
}

fn parameters<M: Module>(module: &M) -> Vec<(u64, Vec<usize>)> {
    let mut parameters = Parameters(Vec::new());
    module.visit(&mut parameters);
    parameters.0
}

/// Fails unless there are both moments and the number of steps for each of the parameters that have a state at all.
fn check_moments(
    parameters: &[(u64, Vec<usize>)],
    arrays: Vec<Array>,
    mut scalars: BTreeMap<String, Scalar>,
) -> std::result::Result<(), String> {
    let mut arrays: BTreeMap<String, Array> =
        arrays.into_iter().map(|array| (array.name.clone(), array)).collect();
    for (id, shape) in parameters {
        let [mean, square] = ["moment_1", "moment_2"].map(|name| format!("{id}.momentum.{name}"));
        let [rank, time] = [format!("{id}.__rank"), format!("{id}.momentum.time")];
        let moments = [arrays.remove(&mean), arrays.remove(&square)];
        let (rank, time) = (scalars.remove(&rank), scalars.remove(&time));
        let [Some(mean), Some(square)] = moments else {
            if moments.iter().all(Option::is_none) && rank.is_none() && time.is_none() {
                continue;
            }
            return Err(format!("the state of parameter {id} lacks a moment"));
        };
        for moment in [&mean, &square] {
            if moment.shape != *shape || moment.id != Some(*id) {
                let (name, got) = (&moment.name, &moment.shape);
                return Err(format!("`{name}` has shape {got:?}, expected {shape:?} of parameter {id}"));
            }
        }
        if square.is_negative {
            return Err(format!("`{}` holds negative numbers, expected squares", square.name));
        }
        if rank.and_then(|rank| usize::try_from(rank).ok()) != Some(shape.len()) {
            return Err(format!("the rank of parameter {id} is {rank:?}, expected {}", shape.len()));
        }
        let steps = time.and_then(|time| u64::try_from(time).ok());
        if !steps.is_some_and(|steps| (1..=MOST_STEPS).contains(&steps)) {
            return Err(format!("parameter {id} was trained for {time:?} steps, expected 1 to {MOST_STEPS}"));
        }
    }
    match arrays.keys().chain(scalars.keys()).next() {
        None => Ok(()),
        Some(name) => Err(format!("`{name}` belongs to no parameter of the network")),
    }
}

fn unreadable(error: impl std::fmt::Display) -> NnError {
    NnError::Record(error.to_string())
}

#[cfg(test)]
mod tests {
    use burn::nn::{Linear, LinearConfig};
    use burn::optim::GradientsParams;
    use burn::tensor::Device;

    use super::*;
    use crate::{Gradients, adam};

    fn step(net: Linear, optimizer: &mut ModuleOptimizer) -> Linear {
        let x = Tensor::<2>::ones([4, 3], &Device::flex().autodiff());
        let gradients = GradientsParams::from_grads((net.forward(x) - 1.0).square().sum().backward(), &net);
        optimizer.step(0.01, net, gradients)
    }

    fn fresh() -> Linear {
        LinearConfig::new(3, 2).init(&Device::flex().autodiff())
    }

    /// The records of a net of 3 inputs and 2 outputs and of its optimiser, after a step.
    fn trained() -> ([Vec<u8>; 2], Linear) {
        let mut optimizer = adam(1e-8, Gradients::Written);
        let net = step(fresh(), &mut optimizer);
        let records = [module_bytes(&net).unwrap().to_vec(), optimizer_bytes(&optimizer).unwrap().to_vec()];
        (records, net)
    }

    #[test]
    fn a_net_and_its_moments_read_back_to_the_bit() {
        let ([record, moments], net) = trained();
        let loaded = load_module(fresh(), record).unwrap();
        assert_eq!(loaded.weight.val().into_data(), net.weight.val().into_data());
        assert_eq!(parameters(&loaded), parameters(&net));
        let mut optimizer = load_optimizer(adam(1e-8, Gradients::Written), &loaded, moments).unwrap();
        step(loaded, &mut optimizer);
    }

    #[test]
    fn records_lie_within_their_sizes_and_sizes_that_cannot_be_counted_are_rejected() {
        let ([record, moments], net) = trained();
        let [fewest, most] = module_size(Some(8)).unwrap();
        assert!((fewest..=most).contains(&(record.len() as u64)));
        assert!(moments.len() as u64 <= optimizer_size(&net));
        for numbers in [None, Some(usize::MAX)] {
            assert!(module_size(numbers).unwrap_err().to_string().contains("beyond all memory"));
        }
    }

    #[test]
    fn whatever_bytes_a_record_has_it_is_used_or_rejected() {
        let (records, _) = trained();
        let (mut used, mut refused) = (0, 0);
        for (which, whole) in records.iter().enumerate() {
            // The description of the arrays comes first; every byte of it is changed in turn, then some of the numbers.
            for at in (0..whole.len()).filter(|at| *at < 600 || at % 64 < 2) {
                for value in [0x00, 0x7f, 0xff, whole[at] ^ 1] {
                    let mut changed = records.clone();
                    changed[which][at] = value;
                    let [record, moments] = changed;
                    let loaded = load_module(fresh(), record).and_then(|net| {
                        Ok((load_optimizer(adam(1e-8, Gradients::Written), &net, moments)?, net))
                    });
                    match loaded {
                        Ok((mut optimizer, net)) => {
                            step(net, &mut optimizer);
                            used += 1;
                        }
                        Err(NnError::Record(_)) => refused += 1,
                        Err(other) => panic!("{other}"),
                    }
                }
            }
        }
        assert!(used > 100 && refused > 1000, "{used} used, {refused} refused");
    }

    #[test]
    fn moments_that_do_not_fit_their_parameters_are_rejected() {
        let parameters = [(7, vec![2, 3])];
        let moment = |name: &str, shape: &[usize]| Array {
            name: format!("7.momentum.{name}"),
            id: Some(7),
            shape: shape.to_vec(),
            is_negative: false,
        };
        let both = |shape: &[usize]| vec![moment("moment_1", shape), moment("moment_2", shape)];
        let scalars = |rank: u64, time: i64| {
            BTreeMap::from([
                ("7.__rank".to_owned(), Scalar::UInt(rank)),
                ("7.momentum.time".to_owned(), Scalar::Int(time)),
            ])
        };
        let check = |arrays, scalars| check_moments(&parameters, arrays, scalars);
        check(both(&[2, 3]), scalars(2, 1)).unwrap();
        check(Vec::new(), BTreeMap::new()).unwrap();
        let refuse = |arrays, scalars, expected: &str| {
            let message = check(arrays, scalars).unwrap_err();
            assert!(message.contains(expected), "{message}");
        };
        refuse(both(&[3, 2]), scalars(2, 1), "has shape [3, 2], expected [2, 3]");
        refuse(vec![moment("moment_1", &[2, 3])], scalars(2, 1), "lacks a moment");
        refuse(Vec::new(), scalars(2, 1), "lacks a moment");
        refuse(both(&[2, 3]), scalars(1, 1), "rank of parameter 7");
        refuse(both(&[2, 3]), scalars(2, 0), "trained for");
        refuse(both(&[2, 3]), scalars(2, i64::from(i32::MAX) + 1), "trained for");
        let mut more = both(&[2, 3]);
        more.push(moment("other", &[2, 3]));
        refuse(more, scalars(2, 1), "belongs to no parameter");
        let mut negative = both(&[2, 3]);
        negative[1].is_negative = true;
        refuse(negative, scalars(2, 1), "expected squares");
    }
}
