//! Frames: the particles at one time as a VTK file.
//!
//! VTK XML PolyData, arrays inline as base64 of zlib blocks, little-endian, 64-bit headers. Source: VTK user's guide, "VTK file
//! formats"; `vtkXMLDataParser` (compressed data: number of blocks, block size, size of the last partial block, compressed sizes).

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::folder::RunFolder;
use crate::case::Precision;
use crate::math::Vector;
use crate::particles::{Field, FieldValue, Particles, field_table};

/// Bytes compressed at a time: VTK's own choice.
const BLOCK: usize = 32_768;

/// Least time between two writings of `frames.pvd`, which lists all frames.
const INDEX_EVERY: Duration = Duration::from_millis(500);

/// Writes frames into `frames/` of a run folder, and the list of them.
pub(super) struct Frames<const D: usize> {
    fields: Vec<Field<D>>,
    precision: Precision,
    /// Times still to come are those from `next` on.
    times: Vec<f64>,
    next: usize,
    written: Vec<f64>,
    indexed: Option<Instant>,
}

impl<const D: usize> Frames<D> {
    /// Frames at `times` (s, rising) with the columns `names`.
    pub fn new(names: &[&'static str], precision: Precision, times: Vec<f64>) -> Self {
        let fields = field_table::<D>().into_iter().filter(|field| names.contains(&field.name)).collect();
        Self { fields, precision, times, next: 0, written: Vec::new(), indexed: None }
    }

    /// Number of frames written.
    pub fn count(&self) -> usize {
        self.written.len()
    }

    /// Whether a frame is due at `time`, s.
    pub fn due(&self, time: f64) -> bool {
        self.times.get(self.next).is_some_and(|&next| time >= next)
    }

    /// Writes a frame.
    pub fn write(&mut self, folder: &RunFolder, p: &Particles<D>, time: f64) -> io::Result<()> {
        let text = self.vtp(p, time)?;
        folder.write(&format!("frames/{}", name(self.count())), text.as_bytes())?;
        self.written.push(time);
        self.next += self.times[self.next..].iter().take_while(|&&due| due <= time).count();
        if self.indexed.is_none_or(|last| last.elapsed() >= INDEX_EVERY) {
            self.write_index(folder)?;
        }
        Ok(())
    }

    /// Writes `frames.pvd`.
    pub fn write_index(&mut self, folder: &RunFolder) -> io::Result<()> {
        let mut text = String::from(
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>\n",
        );
        for (i, time) in self.written.iter().enumerate() {
            let _ = writeln!(text, "<DataSet timestep=\"{time}\" part=\"0\" file=\"{}\"/>", name(i));
        }
        text.push_str("</Collection>\n</VTKFile>\n");
        self.indexed = Some(Instant::now());
        folder.write("frames/frames.pvd", text.as_bytes())
    }

    fn vtp(&self, p: &Particles<D>, time: f64) -> io::Result<String> {
        let n = p.owned();
        let mut text = String::with_capacity(64 * n + 4096);
        text.push_str("<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" ");
        text.push_str("header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\">\n<PolyData>\n<FieldData>\n");
        let _ = writeln!(text, r#"<DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">{time}</DataArray>"#);
        let _ = writeln!(text, "</FieldData>\n<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{}\">\n<PointData>", usize::from(n > 0));
        for field in &self.fields {
            self.column(&mut text, field, p)?;
        }
        text.push_str("</PointData>\n<Points>\n");
        let mut bytes = Vec::with_capacity(24 * n);
        for a in 0..n {
            self.push_vector(&mut bytes, p.x[a]);
        }
        array(&mut text, "Points", self.float(), 3, &bytes)?;
        // One cell that holds every point, so that viewers show them.
        text.push_str("</Points>\n<Verts>\n");
        let connectivity: Vec<u8> = (0..n as u64).flat_map(u64::to_le_bytes).collect();
        array(&mut text, "connectivity", "Int64", 1, &connectivity)?;
        let offsets = if n > 0 { (n as u64).to_le_bytes().to_vec() } else { Vec::new() };
        array(&mut text, "offsets", "Int64", 1, &offsets)?;
        text.push_str("</Verts>\n</Piece>\n</PolyData>\n</VTKFile>\n");
        Ok(text)
    }

    fn column(&self, text: &mut String, field: &Field<D>, p: &Particles<D>) -> io::Result<()> {
        let n = p.owned();
        let mut bytes = Vec::with_capacity(8 * n);
        let (mut kind, mut components) = (self.float(), 1);
        for a in 0..n {
            match (field.value)(p, a) {
                FieldValue::Scalar(value) => self.push(&mut bytes, value),
                FieldValue::Vector(value) => {
                    components = 3;
                    self.push_vector(&mut bytes, value);
                }
                FieldValue::Integer(value) => {
                    kind = "UInt32";
                    bytes.extend(value.to_le_bytes());
                }
                FieldValue::Flag(value) => {
                    kind = "UInt8";
                    bytes.push(value);
                }
            }
        }
        array(text, field.name, kind, components, &bytes)
    }

    fn float(&self) -> &'static str {
        match self.precision {
            Precision::Float64 => "Float64",
            Precision::Float32 => "Float32",
        }
    }

    fn push(&self, bytes: &mut Vec<u8>, value: f64) {
        match self.precision {
            Precision::Float64 => bytes.extend(value.to_le_bytes()),
            Precision::Float32 => bytes.extend((value as f32).to_le_bytes()),
        }
    }

    /// Three components, the missing ones 0.
    fn push_vector(&self, bytes: &mut Vec<u8>, value: Vector<D>) {
        for d in 0..3 {
            self.push(bytes, value.0.get(d).copied().unwrap_or(0.0));
        }
    }
}

/// File name of frame `i`.
fn name(i: usize) -> String {
    format!("frame-{i:06}.vtp")
}

/// Appends an array with its bytes compressed in blocks.
fn array(text: &mut String, name: &str, kind: &str, components: usize, bytes: &[u8]) -> io::Result<()> {
    let _ = writeln!(text, r#"<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">"#);
    let mut header = vec![bytes.len().div_ceil(BLOCK) as u64, BLOCK as u64, (bytes.len() % BLOCK) as u64];
    let mut data = Vec::new();
    for block in bytes.chunks(BLOCK) {
        let before = data.len();
        let mut encoder = ZlibEncoder::new(&mut data, Compression::fast());
        encoder.write_all(block)?;
        encoder.finish()?;
        header.push((data.len() - before) as u64);
    }
    let header: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
    STANDARD.encode_string(header, text);
    STANDARD.encode_string(data, text);
    text.push_str("\n</DataArray>\n");
    Ok(())
}
