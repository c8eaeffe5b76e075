//! Frames: the particles at one time as a VTK file.
//!
//! VTK XML PolyData, arrays inline as base64 of zlib blocks, little-endian, 64-bit headers. Source: VTK user's guide, "VTK file
//! formats"; `vtkXMLDataParser` (compressed data: number of blocks, block size, size of the last partial block, compressed sizes).

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::thread::{self, JoinHandle};
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

/// Writes frames into `frames/` of a run folder, and the list of them. A frame is compressed and written by a thread of its own while the
/// run goes on: a step waits for the disk only where frames come faster than they can be written.
pub(super) struct Frames<const D: usize> {
    fields: Vec<Field<D>>,
    precision: Precision,
    /// Times still to come are those from `next` on.
    times: Vec<f64>,
    next: usize,
    written: Vec<f64>,
    under_way: Option<(Frame, JoinHandle<io::Result<()>>)>,
    indexed: Option<Instant>,
}

/// A frame: its number, its time (s) and step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub index: usize,
    pub time: f64,
    pub step: u64,
}

impl<const D: usize> Frames<D> {
    /// Frames at `times` (s, rising) with the columns `names`.
    pub fn new(names: &[&'static str], precision: Precision, times: Vec<f64>) -> Self {
        let fields = field_table::<D>().into_iter().filter(|field| names.contains(&field.name)).collect();
        Self { fields, precision, times, next: 0, written: Vec::new(), under_way: None, indexed: None }
    }

    /// Number of frames on the disk.
    pub fn count(&self) -> usize {
        self.written.len()
    }

    /// Whether a frame is due at `time`, s.
    pub fn due(&self, time: f64) -> bool {
        self.times.get(self.next).is_some_and(|&next| time >= next)
    }

    /// Takes a frame of the particles at `time`, s, and sends it on its way; answers the one before, which is on the disk now.
    ///
    /// # Errors
    /// What kept the one before from the disk.
    pub fn write(&mut self, folder: &RunFolder, p: &Particles<D>, time: f64, step: u64) -> io::Result<Option<Frame>> {
        let before = self.settle(folder)?;
        let frame = Frame { index: self.count(), time, step };
        let (columns, folder) = (self.columns(p), folder.clone());
        let write = move || folder.write(&format!("frames/{}", name(frame.index)), columns.vtp(time)?.as_bytes());
        self.under_way = Some((frame, thread::Builder::new().name("frame".into()).spawn(write)?));
        self.next += self.times[self.next..].iter().take_while(|&&due| due <= time).count();
        Ok(before)
    }

    /// Waits for the frame that is on its way, and answers it.
    ///
    /// # Errors
    /// What kept it from the disk.
    pub fn settle(&mut self, folder: &RunFolder) -> io::Result<Option<Frame>> {
        let Some((frame, writing)) = self.under_way.take() else { return Ok(None) };
        writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
        self.written.push(frame.time);
        if self.indexed.is_none_or(|last| last.elapsed() >= INDEX_EVERY) {
            self.write_index(folder)?;
        }
        Ok(Some(frame))
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

    /// A copy of what a frame holds.
    fn columns(&self, p: &Particles<D>) -> Columns {
        let n = p.owned();
        let mut points = Vec::with_capacity(24 * n);
        for a in 0..n {
            self.push_vector(&mut points, p.x[a]);
        }
        let points = Column { name: "Points", kind: self.float(), components: 3, bytes: points };
        Columns { n, points, fields: self.fields.iter().map(|field| self.column(field, p)).collect() }
    }

    fn column(&self, field: &Field<D>, p: &Particles<D>) -> Column {
        let n = p.owned();
        let mut column = Column { name: field.name, kind: self.float(), components: 1, bytes: Vec::with_capacity(8 * n) };
        for a in 0..n {
            match (field.value)(p, a) {
                FieldValue::Scalar(value) => self.push(&mut column.bytes, value),
                FieldValue::Vector(value) => {
                    column.components = 3;
                    self.push_vector(&mut column.bytes, value);
                }
                FieldValue::Integer(value) => {
                    column.kind = "UInt32";
                    column.bytes.extend(value.to_le_bytes());
                }
                FieldValue::Flag(value) => {
                    column.kind = "UInt8";
                    column.bytes.push(value);
                }
            }
        }
        column
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

/// Particles as a file holds them.
struct Columns {
    /// Particles.
    n: usize,
    points: Column,
    fields: Vec<Column>,
}

/// A data array.
struct Column {
    name: &'static str,
    /// VTK's name of the type.
    kind: &'static str,
    components: usize,
    /// Little-endian.
    bytes: Vec<u8>,
}

impl Columns {
    fn vtp(&self, time: f64) -> io::Result<String> {
        let n = self.n;
        let mut text = String::with_capacity(64 * n + 4096);
        text.push_str("<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" ");
        text.push_str("header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\">\n<PolyData>\n<FieldData>\n");
        let _ = writeln!(text, r#"<DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">{time}</DataArray>"#);
        let _ = writeln!(text, "</FieldData>\n<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{}\">\n<PointData>", usize::from(n > 0));
        for field in &self.fields {
            array(&mut text, field)?;
        }
        text.push_str("</PointData>\n<Points>\n");
        array(&mut text, &self.points)?;
        // One cell that holds every point, so that viewers show them.
        text.push_str("</Points>\n<Verts>\n");
        let integers = |name, bytes| Column { name, kind: "Int64", components: 1, bytes };
        array(&mut text, &integers("connectivity", (0..n as u64).flat_map(u64::to_le_bytes).collect()))?;
        array(&mut text, &integers("offsets", if n > 0 { (n as u64).to_le_bytes().to_vec() } else { Vec::new() }))?;
        text.push_str("</Verts>\n</Piece>\n</PolyData>\n</VTKFile>\n");
        Ok(text)
    }
}

/// File name of frame `i`.
fn name(i: usize) -> String {
    format!("frame-{i:06}.vtp")
}

/// Appends an array with its bytes compressed in blocks.
fn array(text: &mut String, Column { name, kind, components, bytes }: &Column) -> io::Result<()> {
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
