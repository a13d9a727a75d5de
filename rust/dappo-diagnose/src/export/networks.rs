//! Networks as tensors by name, and back.
//!
//! | of | tensors |
//! |---|---|
//! | a policy | `input.mean`, `input.scale` `[O]`, `layers.I.weight` `[inputs, outputs]`, `layers.I.bias`; of a recurrent one `lstm.*`, as of a diagnoser |
//! | a diagnoser | `input.mean`, `input.scale` `[F]`, `embedding.*`, `lstm.input.*`, `lstm.recurrent` `[H, 4 H]` (gates input, forget, cell, output), `hidden.I.*`, `head.*` |

use burn::module::Param;
use burn::tensor::TensorData;
use dappo_learn::error::Result;
use dappo_nn::{
    CLIP, DiagnoserNet, EmbeddedLstm, FrozenLstm, FrozenMlp, InputTransform, Policy, Standardizer, cpu, read,
};

use super::header::{DiagnoserHeader, ExportHeader, PolicyHeader, input_blocks};
use super::tensors::{Reader, Tensors};
use crate::Diagnoser;

/// The tensors of an LSTM.
const LSTM: [&str; 3] = ["lstm.input.weight", "lstm.input.bias", "lstm.recurrent"];

/// The header of a policy whose files are named after `name`.
pub(super) fn policy_header(name: &str, policy: &Policy) -> PolicyHeader {
    PolicyHeader {
        onnx: format!("{name}.onnx"),
        tensors: format!("{name}.safetensors"),
        lstm: policy.memory().map(FrozenLstm::units),
        layers: policy.net().sizes().to_vec(),
        code_length: policy.code_length(),
        code_scale: policy.transform().code_scale(),
        clip: CLIP,
    }
}

/// The header of a diagnoser.
pub(super) fn diagnoser_header(diagnoser: &Diagnoser) -> DiagnoserHeader {
    let description = diagnoser.description();
    DiagnoserHeader {
        onnx: "diagnoser.onnx".into(),
        tensors: "diagnoser.safetensors".into(),
        method: description.method,
        inputs: input_blocks(description.method),
        timesteps: description.timesteps,
        head: description.head,
        embedding: description.embedding,
        lstm: description.lstm,
        hidden: description.hidden.clone(),
        held_out: description.held_out.clone(),
        clip: CLIP,
    }
}

pub(super) fn policy_tensors(policy: &Policy) -> Result<Tensors> {
    let mut tensors = with_statistics(policy.standardizer()?)?;
    if let Some(memory) = policy.memory() {
        let (inputs, gates) = (memory.inputs(), 4 * memory.units());
        let (weight, rest) = memory.parameters().split_at(inputs * gates);
        let (bias, recurrent) = rest.split_at(gates);
        tensors.put(LSTM[0], &[inputs, gates], weight.to_vec())?;
        tensors.put(LSTM[1], &[gates], bias.to_vec())?;
        tensors.put(LSTM[2], &[memory.units(), gates], recurrent.to_vec())?;
    }
    for (index, ([inputs, outputs], weight, bias)) in policy.net().layers().enumerate() {
        tensors.put(&format!("layers.{index}.weight"), &[inputs, outputs], weight.to_vec())?;
        tensors.put(&format!("layers.{index}.bias"), &[outputs], bias.to_vec())?;
    }
    Ok(tensors)
}

pub(super) fn read_policy(header: &PolicyHeader, obs_dim: usize, file: &Reader<'_>) -> Result<Policy> {
    let mut parameters = Vec::new();
    for (index, pair) in header.layers.windows(2).enumerate() {
        parameters.extend(file.array(&format!("layers.{index}.weight"), pair)?);
        parameters.extend(file.array(&format!("layers.{index}.bias"), &pair[1..])?);
    }
    let statistics = read_statistics(obs_dim, file)?;
    let memory = match header.lstm {
        None => None,
        Some(units) => {
            let shapes =
                [vec![obs_dim + header.code_length, 4 * units], vec![4 * units], vec![units, 4 * units]];
            let arrays = LSTM.into_iter().zip(&shapes).map(|(name, shape)| file.array(name, shape));
            let parameters = arrays.collect::<Result<Vec<_>>>()?.concat();
            Some(FrozenLstm::new(units, parameters).map_err(|error| file.blame(error))?)
        }
    };
    FrozenMlp::new(header.layers.clone(), parameters)
        .and_then(|net| {
            let transform = InputTransform::standardized(statistics, header.code_length, header.code_scale)?;
            Policy::recurrent(memory, net, transform)
        })
        .map_err(|error| file.blame(error))
}

pub(super) fn diagnoser_tensors(diagnoser: &Diagnoser) -> Result<Tensors> {
    let mut tensors = with_statistics(&diagnoser.description().standardizer)?;
    let DiagnoserNet { lstm, hidden, head } = diagnoser.net();
    tensors.put_linear("embedding", &lstm.embedding)?;
    tensors.put_linear("lstm.input", &lstm.input)?;
    let width = lstm.sizes().hidden;
    tensors.put("lstm.recurrent", &[width, 4 * width], read(lstm.recurrent.val())?)?;
    for (index, layer) in hidden.iter().enumerate() {
        tensors.put_linear(&format!("hidden.{index}"), layer)?;
    }
    tensors.put_linear("head", head)?;
    Ok(tensors)
}

pub(super) fn read_diagnoser(
    header: &ExportHeader,
    part: &DiagnoserHeader,
    file: &Reader<'_>,
) -> Result<Diagnoser> {
    let inputs = part.method.input_dim(header.obs_dim, header.action_dim);
    let description = header.description(part, read_statistics(inputs, file)?)?;
    description.check().map_err(|error| file.blame(error))?;
    let sizes = description.sizes();
    let recurrent = [sizes.lstm, 4 * sizes.lstm];
    let lstm = EmbeddedLstm {
        embedding: file.linear("embedding", sizes.inputs, sizes.embedding)?,
        input: file.linear("lstm.input", sizes.embedding, 4 * sizes.lstm)?,
        recurrent: Param::from_data(
            TensorData::new(file.array("lstm.recurrent", &recurrent)?, recurrent),
            &cpu(),
        ),
    };
    let widths = [&[sizes.lstm], sizes.hidden.as_slice()].concat();
    let layer = |(index, pair): (usize, &[usize])| file.linear(&format!("hidden.{index}"), pair[0], pair[1]);
    let hidden: Result<Vec<_>> = widths.windows(2).enumerate().map(layer).collect();
    let head = file.linear("head", widths[widths.len() - 1], sizes.outputs)?;
    Ok(Diagnoser::new(description, DiagnoserNet { lstm, hidden: hidden?, head }))
}

fn with_statistics(standardizer: &Standardizer) -> Result<Tensors> {
    let mut tensors = Tensors::default();
    let width = standardizer.input_dim();
    tensors.put("input.mean", &[width], standardizer.mean().to_vec())?;
    tensors.put("input.scale", &[width], standardizer.scale().to_vec())?;
    Ok(tensors)
}

fn read_statistics(width: usize, file: &Reader<'_>) -> Result<Standardizer> {
    Ok(Standardizer::of(file.array("input.mean", &[width])?, file.array("input.scale", &[width])?)?)
}
