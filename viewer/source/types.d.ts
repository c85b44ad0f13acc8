// The data of a page, which script.py writes, and what modules hand to each other.

type Numbers = Int32Array | Float64Array;
type Span = [number, number]; // start and stop in s
type Place = [number, number] | null; // in m

declare const KINDS: Record<string, { name: string; many: string; icon: string; dark: string; light: string }>;
declare const GROUND: string;
declare const RECORDINGS: string[];
declare const REPORTS: Report[];
declare const wasm_bindgen: any; // Rerun's own script
declare const IMAGES: (Images | null)[];

interface Actor {
  id: number; kind: string; type: string; role: string; label: string; hero: boolean; color: string; paint: string | null;
  shape: string; box: [number, number, number, number]; since: number | null; until: number | null;
}
interface Incident {
  kind: string; start: number | null; stop: number | null; actors: number[]; types: string[]; place: Place; text: string;
  picture: string | null;
}
interface Report {
  program: string; source: string; map: string; date: string | null; version: number; frames: number; duration: number | null;
  kinds: [string, number, string][]; lights: [string, string][]; whole: boolean; omitted: number; follow: number | null;
  incidents: Incident[]; drawn: boolean; viewer: boolean; opening?: { time: number | null; actors: number[]; notes: string[] };
  differences?: { over: boolean; text: string; since: number | null; pairs: [number, number | null, number, number | null][] };
}
interface Images { camera: string; size: [number, number]; longest: number; times: number[]; images: string[] }
interface Changes { actor: Numbers; time: Numbers; value: Numbers }
type Measured = { id: number } & Record<string, Numbers>;
interface RecordingData {
  times: Numbers; spans: Span[]; actors: Actor[]; tracks: Numbers[]; x: Numbers; y: Numbers; yaw: Numbers; speed: Numbers;
  measured: Measured[]; lights: Changes; lying: Changes; lamps: Changes;
  marks: [number, [number, number][]][]; // since when, and where they are
}
interface LineData { x: Numbers; y: Numbers; lengths: Numbers }
interface GroundData { width: number; paths: LineData; layers: string[]; layer: Numbers; rings: Numbers; surfaces: LineData }

interface Pose { x: number; y: number; yaw: number }
interface Drawn extends Pose { actor: number; left: number; top: number }
type Camera = import("./camera").Camera;
type Recorded = import("./recorded").Recorded;
type Stage = import("./stage").Stage;
interface Box { left: number; low: number; right: number; high: number }
interface Series { times: Numbers; leader: Int32Array; isMeasured: boolean; values: Record<string, Float64Array> }
interface Item {
  row: HTMLElement; button: HTMLButtonElement; replayed: boolean; recording: Recorded; incident: Incident;
  kind: string; index: number; start: number;
}
