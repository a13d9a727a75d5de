//! Builds an ONNX graph node by node.

use prost::Message;

use super::proto::{
    AttributeProto, DimensionProto, FLOAT, GraphProto, INT64, ModelProto, NodeProto, OperatorSetIdProto,
    TensorProto, TensorShapeProto, TensorTypeProto, TypeProto, ValueInfoProto,
};

/// Version of the operators, of 2022: every runtime since supports it, and no later change of them is needed.
const OPSET: i64 = 17;
/// Version of the file format that came with it.
const IR_VERSION: i64 = 8;
/// Name of the dimension that counts rows.
const ROWS: &str = "N";

/// A graph under construction. Values are identified by their names.
pub(super) struct Graph {
    graph: GraphProto,
}

/// An attribute of a node.
pub(super) enum Attribute {
    /// One whole number.
    Int(&'static str, i64),
    /// Several.
    Ints(&'static str, Vec<i64>),
}

impl Graph {
    pub fn new(name: &str) -> Self {
        Self { graph: GraphProto { name: name.into(), ..GraphProto::default() } }
    }

    /// An input `[N, shape…]`.
    pub fn input(&mut self, name: &str, shape: &[usize]) {
        self.graph.input.push(value(name, shape));
    }

    /// Makes a value `[N, shape…]` an output.
    pub fn output(&mut self, name: &str, shape: &[usize]) {
        self.graph.output.push(value(name, shape));
    }

    /// An array of constants.
    pub fn constant(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        let raw_data = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.initializer(name, shape, FLOAT, raw_data);
    }

    /// A list of whole numbers.
    pub fn indices(&mut self, name: &str, values: &[i64]) {
        let raw_data = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.initializer(name, &[values.len()], INT64, raw_data);
    }

    fn initializer(&mut self, name: &str, shape: &[usize], data_type: i32, raw_data: Vec<u8>) {
        let dims = shape.iter().map(|&length| length as i64).collect();
        self.graph.initializer.push(TensorProto { dims, data_type, name: name.into(), raw_data });
    }

    /// A node with one output, which is named; an input or output named "" is left out.
    pub fn node(&mut self, op: &str, inputs: &[&str], output: &str) {
        self.node_with(op, inputs, &[output], Vec::new());
    }

    /// The same with attributes and any number of outputs.
    pub fn node_with(&mut self, op: &str, inputs: &[&str], outputs: &[&str], attributes: Vec<Attribute>) {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        let name = outputs.iter().find(|name| !name.is_empty()).copied().unwrap_or_default();
        self.graph.node.push(NodeProto {
            input: names(inputs),
            output: names(outputs),
            name: format!("{op}_{name}"),
            op_type: op.into(),
            attribute: attributes.into_iter().map(attribute).collect(),
        });
    }

    /// Bytes of an ONNX file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let model = ModelProto {
            ir_version: IR_VERSION,
            producer_name: "dappo-batch".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(self.graph.clone()),
            opset_import: vec![OperatorSetIdProto { version: OPSET }],
        };
        model.encode_to_vec()
    }
}

fn attribute(attribute: Attribute) -> AttributeProto {
    match attribute {
        Attribute::Int(name, i) => AttributeProto {
            name: name.into(),
            i: Some(i),
            kind: AttributeProto::INT,
            ..AttributeProto::default()
        },
        Attribute::Ints(name, ints) => {
            AttributeProto { name: name.into(), i: None, ints, kind: AttributeProto::INTS }
        }
    }
}

fn value(name: &str, shape: &[usize]) -> ValueInfoProto {
    let rows = DimensionProto { dim_param: Some(ROWS.into()), dim_value: None };
    let fixed = |&length: &usize| DimensionProto { dim_value: Some(length as i64), dim_param: None };
    let shape = TensorShapeProto { dim: std::iter::once(rows).chain(shape.iter().map(fixed)).collect() };
    let tensor = TensorTypeProto { elem_type: FLOAT, shape: Some(shape) };
    ValueInfoProto { name: name.into(), r#type: Some(TypeProto { tensor_type: Some(tensor) }) }
}
