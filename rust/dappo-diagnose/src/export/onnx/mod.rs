//! The networks as ONNX, from raw inputs to what they are for.

mod graph;
mod proto;

use super::header::{DiagnoserHeader, ExportHeader, PolicyHeader};
use super::tensors::{Array, Tensors};
use crate::Head;
use dappo_learn::error::Result;
use graph::{Attribute, Graph};

/// A policy: `obs` `[N, O + code_length]`, raw and followed by the damage code → `action` `[N, A]`, clipped to ±1,
/// and `mean_action` `[N, A]`, the same before the clip. A recurrent one has `hidden` and `cell` `[N, H]`, too, which
/// become `next_hidden` and `next_cell`.
pub(super) fn policy(header: &PolicyHeader, tensors: &Tensors) -> Result<Vec<u8>> {
    let widths = &header.layers;
    let (outputs, last) = (widths[widths.len() - 1], widths.len() - 2);
    let inputs = widths[0] - header.lstm.unwrap_or(0);
    let mut graph = Graph::new("policy");
    graph.input("obs", &[inputs]);
    // The damage code passes by the statistics and their bound.
    let code = |entry: f32| std::iter::repeat_n(entry, header.code_length);
    let tracked = inputs - header.code_length;
    let (mean, scale) = statistics(tensors)?;
    let bound: Vec<f32> = std::iter::repeat_n(header.clip, tracked).chain(code(f32::MAX)).collect();
    graph.constant("mean", &[inputs], &mean.iter().copied().chain(code(0.0)).collect::<Vec<_>>());
    graph.constant(
        "scale",
        &[inputs],
        &scale.iter().copied().chain(code(header.code_scale)).collect::<Vec<_>>(),
    );
    graph.constant("upper", &[inputs], &bound);
    graph.constant("lower", &[inputs], &bound.iter().map(|x| -x).collect::<Vec<_>>());
    match header.lstm {
        None => standardize(&mut graph, "obs", "h0"),
        Some(units) => {
            standardize(&mut graph, "obs", "observed");
            add_memory(&mut graph, units, tensors)?;
            graph.node_with("Concat", &["observed", "next_hidden"], &["h0"], vec![Attribute::Int("axis", 1)]);
        }
    }
    for layer in 0..=last {
        add_linear(
            &mut graph,
            &format!("layers.{layer}"),
            tensors,
            &format!("h{layer}"),
            &format!("z{layer}"),
        )?;
        if layer < last {
            graph.node("Tanh", &[&format!("z{layer}")], &format!("h{}", layer + 1));
        }
    }
    graph.constant("most", &[], &[1.0]);
    graph.constant("least", &[], &[-1.0]);
    let mean = format!("z{last}");
    graph.node("Identity", &[&mean], "mean_action");
    graph.node("Clip", &[&mean, "least", "most"], "action");
    graph.output("action", &[outputs]);
    graph.output("mean_action", &[outputs]);
    if let Some(units) = header.lstm {
        graph.output("next_hidden", &[units]);
        graph.output("next_cell", &[units]);
    }
    Ok(graph.to_bytes())
}

/// A diagnoser: `window` `[N, T, F]`, raw → `probabilities` `[N, C]`.
pub(super) fn diagnoser(header: &ExportHeader, part: &DiagnoserHeader, tensors: &Tensors) -> Result<Vec<u8>> {
    let DiagnoserHeader { timesteps, lstm, ref hidden, head, clip, .. } = *part;
    let (mean, scale) = statistics(tensors)?;
    let mut graph = Graph::new("diagnoser");
    graph.input("window", &[timesteps, mean.len()]);
    graph.constant("mean", &[mean.len()], mean);
    graph.constant("scale", &[mean.len()], scale);
    graph.constant("upper", &[], &[clip]);
    graph.constant("lower", &[], &[-clip]);
    standardize(&mut graph, "window", "steps");
    add_lstm(&mut graph, lstm, tensors)?;
    for layer in 0..hidden.len() {
        let (name, out) = (format!("hidden.{layer}"), format!("z{layer}"));
        add_linear(&mut graph, &name, tensors, &format!("h{layer}"), &out)?;
        graph.node("Relu", &[&out], &format!("h{}", layer + 1));
    }
    add_linear(&mut graph, "head", tensors, &format!("h{}", hidden.len()), "outputs")?;
    let classes = header.classes.len();
    let scores = match head {
        Head::Classes => "outputs",
        Head::Limbs => {
            // A class's score is Σ ln σ(z) over the bits of its code that are 1 and Σ ln σ(−z) over the others. As
            // ln σ(z) = ln σ(−z) + z, it is Σ z over its bits and a sum that all classes share, which the softmax
            // cancels.
            let bits = header.classes[0].code.len();
            let codes = |at: usize| f32::from(header.classes[at % classes].code[at / classes]);
            graph.constant("codes", &[bits, classes], &(0..bits * classes).map(codes).collect::<Vec<_>>());
            graph.node("MatMul", &["outputs", "codes"], "scores");
            "scores"
        }
    };
    graph.node_with("Softmax", &[scores], &["probabilities"], vec![Attribute::Int("axis", 1)]);
    graph.output("probabilities", &[classes]);
    Ok(graph.to_bytes())
}

/// Mean and scale of the inputs.
fn statistics(tensors: &Tensors) -> Result<(&[f32], &[f32])> {
    Ok((&tensors.get("input.mean")?.values, &tensors.get("input.scale")?.values))
}

/// `output` = clip((`input` − mean) · scale, ±bound).
fn standardize(graph: &mut Graph, input: &str, output: &str) {
    graph.node("Sub", &[input, "mean"], "centred");
    graph.node("Mul", &["centred", "scale"], "scaled");
    graph.node("Max", &["scaled", "lower"], "raised");
    graph.node("Min", &["raised", "upper"], output);
}

fn add_constant(graph: &mut Graph, name: &str, tensors: &Tensors) -> Result<()> {
    let Array { shape, values } = tensors.get(name)?;
    graph.constant(name, shape, values);
    Ok(())
}

/// A linear layer over rows.
fn add_linear(graph: &mut Graph, name: &str, tensors: &Tensors, input: &str, output: &str) -> Result<()> {
    let (weight, bias) = (format!("{name}.weight"), format!("{name}.bias"));
    add_constant(graph, &weight, tensors)?;
    add_constant(graph, &bias, tensors)?;
    graph.node("Gemm", &[input, &weight, &bias], output);
    Ok(())
}

/// From `steps`, `[N, T, F]`, to the last hidden state `h0`, `[N, H]`.
fn add_lstm(graph: &mut Graph, hidden: usize, tensors: &Tensors) -> Result<()> {
    add_constant(graph, "embedding.weight", tensors)?;
    add_constant(graph, "embedding.bias", tensors)?;
    graph.node("MatMul", &["steps", "embedding.weight"], "product");
    graph.node("Add", &["product", "embedding.bias"], "embedded");
    // ONNX requires time first.
    graph.node_with("Transpose", &["embedded"], &["sequence"], vec![Attribute::Ints("perm", vec![1, 0, 2])]);
    add_gates(graph, hidden, tensors)?;
    let size = vec![Attribute::Int("hidden_size", hidden as i64)];
    graph.node_with("LSTM", &["sequence", "W", "R", "B"], &["", "last"], size);
    graph.indices("direction", &[0]);
    graph.node("Squeeze", &["last", "direction"], "h0");
    Ok(())
}

/// One step from `observed`, `[N, I]`, and the states `hidden` and `cell`, `[N, H]`, to the next states.
fn add_memory(graph: &mut Graph, units: usize, tensors: &Tensors) -> Result<()> {
    graph.indices("direction", &[0]);
    for (flat, with_time) in [("observed", "sequence"), ("hidden", "hidden_before"), ("cell", "cell_before")]
    {
        if flat != "observed" {
            graph.input(flat, &[units]);
        }
        graph.node("Unsqueeze", &[flat, "direction"], with_time);
    }
    add_gates(graph, units, tensors)?;
    let inputs = ["sequence", "W", "R", "B", "", "hidden_before", "cell_before"];
    let size = vec![Attribute::Int("hidden_size", units as i64)];
    graph.node_with("LSTM", &inputs, &["", "hidden_after", "cell_after"], size);
    graph.node("Squeeze", &["hidden_after", "direction"], "next_hidden");
    graph.node("Squeeze", &["cell_after", "direction"], "next_cell");
    Ok(())
}

/// The parameters `W`, `R` and `B` of an LSTM.
fn add_gates(graph: &mut Graph, hidden: usize, tensors: &Tensors) -> Result<()> {
    let gates = 4 * hidden;
    let input = tensors.get("lstm.input.weight")?;
    graph.constant("W", &[1, gates, input.shape[0]], &gate_rows(input, hidden));
    graph.constant("R", &[1, gates, hidden], &gate_rows(tensors.get("lstm.recurrent")?, hidden));
    // ONNX has two biases, whose sum counts.
    let bias = Array { shape: vec![1, gates], values: tensors.get("lstm.input.bias")?.values.clone() };
    let mut biases = gate_rows(&bias, hidden);
    biases.resize(2 * gates, 0.0);
    graph.constant("B", &[1, 2 * gates], &biases);
    Ok(())
}

/// The transpose of a weight `[inputs, 4 H]`, with the gates input, forget, cell, output in ONNX's order: input,
/// output, forget, cell.
fn gate_rows(weight: &Array, hidden: usize) -> Vec<f32> {
    let (inputs, gates) = (weight.shape[0], 4 * hidden);
    let columns = [0, 3, 1, 2].into_iter().flat_map(|gate| gate * hidden..(gate + 1) * hidden);
    columns.flat_map(|column| (0..inputs).map(move |row| weight.values[row * gates + column])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gates_are_transposed_into_the_order_of_onnx() {
        // Two inputs, hidden state of one: columns are the gates i, f, c, o.
        let weight = Array { shape: vec![2, 4], values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0] };
        assert_eq!(gate_rows(&weight, 1), [1.0, 5.0, 4.0, 8.0, 2.0, 6.0, 3.0, 7.0]);
    }
}
