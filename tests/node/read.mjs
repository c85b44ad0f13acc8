// Reads MCAP files with the libraries that Foxglove itself uses, checks them, and prints what each holds as a line of JSON.
// usage: node read.mjs FILE.mcap...

import { open } from "node:fs/promises";

import { crc32Final, crc32Init, crc32Update } from "@foxglove/crc";
import { McapConstants, McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";
import protobuf from "protobufjs";
import "protobufjs/ext/descriptor.js";

const { MCAP_MAGIC, Opcode } = McapConstants;
const RECORD_HEAD = 9; // opcode u8, length u64

function check(holds, violation) {
  if (!holds) throw new Error(violation);
}

function equal(found, expected, what) {
  check(found === expected, `${what}: found ${found}, expected ${expected}`);
}

const increment = (counts, key) => counts.set(key, (counts.get(key) ?? 0) + 1);

/** The file in pieces of one record each, with their offsets; the magic bytes at both ends are pieces too. */
async function* pieces(readable) {
  const size = await readable.size();
  const magic = BigInt(MCAP_MAGIC.length);
  yield [0n, await readable.read(0n, magic)];
  let offset = magic;
  while (offset < size - magic) {
    const head = await readable.read(offset, BigInt(RECORD_HEAD));
    const length = BigInt(RECORD_HEAD) + new DataView(head.buffer, head.byteOffset).getBigUint64(1, true);
    check(offset + length <= size - magic, `the record at ${offset} runs past the end of the file`);
    yield [offset, await readable.read(offset, length)];
    offset += length;
  }
  yield [offset, await readable.read(offset, magic)];
}

/** A chunk in the linear pass: its messages are added, then its message indexes, then it is finished. */
class ChunkCheck {
  messages = new Map();
  indexed = new Map();
  indexLength = 0n;
  start = undefined;
  end = undefined;

  constructor(offset, length, chunk, index, decompress) {
    check(index, `the chunk at ${offset} is missing in the summary`);
    this.where = `the chunk at ${offset}`;
    this.index = index;
    equal(index.chunkLength, length, `${this.where}, chunkLength`);
    equal(index.compressedSize, BigInt(chunk.records.byteLength), `${this.where}, compressedSize`);
    for (const field of ["compression", "uncompressedSize", "messageStartTime", "messageEndTime"]) {
      equal(index[field], chunk[field], `${this.where}, ${field} in its index`);
    }
    const records = chunk.compression
      ? decompress[chunk.compression](chunk.records, chunk.uncompressedSize)
      : chunk.records;
    equal(BigInt(records.byteLength), chunk.uncompressedSize, `${this.where}, uncompressedSize`);
    this.view = new DataView(Uint8Array.from(records).buffer);
  }

  addMessage({ channelId, logTime }) {
    increment(this.messages, channelId);
    if (this.start == undefined || logTime < this.start) this.start = logTime;
    if (this.end == undefined || logTime > this.end) this.end = logTime;
  }

  addMessageIndex(offset, length, { channelId, records }) {
    const where = `${this.where}, message index of channel ${channelId}`;
    check(!this.indexed.has(channelId), `${where}: there are two`);
    equal(this.index.messageIndexOffsets.get(channelId), offset, `${where}, offset in the chunk index`);
    equal(new Set(records.map(([, at]) => at)).size, records.length, `${where}, distinct offsets`);
    for (const [logTime, at] of records) {
      const entry = `${where}, entry at ${at}`;
      const record = Number(at);
      check(record + RECORD_HEAD + 14 <= this.view.byteLength, `${entry}: past the end of the chunk`);
      equal(this.view.getUint8(record), Opcode.MESSAGE, `${entry}, opcode`);
      equal(this.view.getUint16(record + RECORD_HEAD, true), channelId, `${entry}, channel`);
      equal(this.view.getBigUint64(record + RECORD_HEAD + 6, true), logTime, `${entry}, log time`);
    }
    this.indexed.set(channelId, records.length);
    this.indexLength += length;
  }

  finish() {
    equal(this.index.messageStartTime, this.start ?? 0n, `${this.where}, messageStartTime`);
    equal(this.index.messageEndTime, this.end ?? 0n, `${this.where}, messageEndTime`);
    equal(this.index.messageIndexLength, this.indexLength, `${this.where}, messageIndexLength`);
    for (const channelId of new Set([...this.messages.keys(), ...this.index.messageIndexOffsets.keys()])) {
      equal(this.indexed.get(channelId) ?? 0, this.messages.get(channelId) ?? 0,
        `${this.where}, indexed messages of channel ${channelId}`);
    }
  }
}

/** Reads the file from front to back, with every checksum; returns how many records of each type it holds. */
async function linearPass(readable, indexed, decompressHandlers) {
  const reader = new McapStreamReader({ includeChunks: true, validateCrcs: true, decompressHandlers });
  const chunkIndexes = new Map(indexed.chunkIndexes.map((index) => [index.chunkStartOffset, index]));
  const counts = new Map();
  let dataCrc = crc32Init();
  let chunk;
  for await (const [offset, bytes] of pieces(readable)) {
    const length = BigInt(bytes.byteLength);
    if (offset < indexed.dataEndOffset) dataCrc = crc32Update(dataCrc, bytes);
    reader.append(bytes);
    for (let record; (record = reader.nextRecord()); ) {
      if (offset < indexed.dataEndOffset) increment(counts, record.type);
      switch (record.type) {
        case "Chunk":
          chunk?.finish();
          chunk = new ChunkCheck(offset, length, record, chunkIndexes.get(offset), decompressHandlers);
          break;
        case "Message":
          check(bytes[0] === Opcode.CHUNK, `the message at ${offset} lies outside the chunks`);
          chunk.addMessage(record);
          break;
        case "MessageIndex":
          check(chunk, `the message index at ${offset} follows no chunk`);
          chunk.addMessageIndex(offset, length, record);
          break;
      }
    }
  }
  chunk?.finish();
  check(reader.done(), "the file has no end");
  if (indexed.dataSectionCrc) equal(crc32Final(dataCrc), indexed.dataSectionCrc, "DataEnd.dataSectionCrc");
  return counts;
}

function messageType({ name, encoding, data }) {
  equal(encoding, "protobuf", `schema ${name}, encoding`);
  const root = protobuf.Root.fromDescriptor(data, { keepCase: true });
  root.resolveAll();
  return root.lookupType(name);
}

const readableForm = { longs: String, enums: String, defaults: true, json: true };

/** Reads every message through the index and decodes it; returns what each topic holds. */
async function indexedPass(reader) {
  const channels = new Map();
  for (const { id, topic, schemaId } of reader.channelsById.values()) {
    const schema = reader.schemasById.get(schemaId);
    check(schema, `topic ${topic}: schema ${schemaId} is missing in the summary`);
    const type = messageType(schema);
    channels.set(id, { topic, type, schema: schema.name, count: 0, first: null, last: null });
  }
  let logTime = 0n;
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = channels.get(message.channelId);
    check(channel, `channel ${message.channelId} is missing in the summary`);
    check(message.logTime >= logTime, `topic ${channel.topic}: log time ${message.logTime} after ${logTime}`);
    logTime = message.logTime;
    channel.last = channel.type.decode(Uint8Array.from(message.data)); // a copy: the reader reuses its buffer
    channel.first ??= channel.last;
    channel.count += 1;
  }
  return channels;
}

function checkStatistics({ statistics, schemasById }, channels, counts) {
  check(statistics, "the summary has no statistics");
  const total = [...channels.values()].reduce((sum, { count }) => sum + count, 0);
  equal(counts.get("Message") ?? 0, total, "messages in the linear pass against the indexed one");
  equal(Number(statistics.messageCount), total, "Statistics.messageCount");
  equal(statistics.chunkCount, counts.get("Chunk") ?? 0, "Statistics.chunkCount");
  equal(statistics.attachmentCount, counts.get("Attachment") ?? 0, "Statistics.attachmentCount");
  equal(statistics.metadataCount, counts.get("Metadata") ?? 0, "Statistics.metadataCount");
  equal(statistics.schemaCount, schemasById.size, "Statistics.schemaCount");
  equal(statistics.channelCount, channels.size, "Statistics.channelCount");
  for (const id of new Set([...channels.keys(), ...statistics.channelMessageCounts.keys()])) {
    equal(Number(statistics.channelMessageCounts.get(id) ?? 0), channels.get(id)?.count ?? 0,
      `Statistics.channelMessageCounts of channel ${id}`);
  }
}

async function attachmentsOf(reader) {
  const found = [];
  for await (const attachment of reader.readAttachments({ validateCrcs: true })) {
    const index = reader.attachmentIndexes[found.length];
    const { name, mediaType, logTime, createTime, data } = attachment;
    equal(index.dataSize, BigInt(data.byteLength), `attachment ${name}, dataSize`);
    for (const field of ["name", "mediaType", "logTime", "createTime"]) {
      equal(index[field], attachment[field], `attachment ${name}, ${field} in its index`);
    }
    found.push({ name, mediaType, logTime, createTime, size: data.byteLength });
  }
  return found;
}

async function metadataOf(reader) {
  const found = [];
  for await (const { name, metadata } of reader.readMetadata()) {
    equal(reader.metadataIndexes[found.length].name, name, "metadata, name in its index");
    found.push({ name, metadata: Object.fromEntries(metadata) });
  }
  return found;
}

async function read(path) {
  const file = await open(path);
  try {
    const readable = new FileHandleReadable(file);
    const decompressHandlers = await loadDecompressHandlers();
    const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
    const channels = await indexedPass(reader);
    const counts = await linearPass(readable, reader, decompressHandlers);
    checkStatistics(reader, channels, counts);
    const attachments = await attachmentsOf(reader);
    const metadata = await metadataOf(reader);
    equal(reader.chunkIndexes.length, counts.get("Chunk") ?? 0, "chunk indexes");
    equal(attachments.length, counts.get("Attachment") ?? 0, "attachment indexes");
    equal(metadata.length, counts.get("Metadata") ?? 0, "metadata indexes");
    const topics = {};
    for (const { topic, type, schema, count, first, last } of channels.values()) {
      check(!(topic in topics), `topic ${topic}: there are two channels`);
      const show = (message) => message && type.toObject(message, readableForm);
      topics[topic] = { schema, count, first: show(first), last: show(last) };
    }
    const { type, channelMessageCounts, ...statistics } = reader.statistics;
    const { profile, library } = reader.header;
    return { profile, library, topics, statistics, attachments, metadata };
  } finally {
    await file.close();
  }
}

/** Writes bytes as hexadecimal digits and 64-bit numbers as strings. */
function replacer(key, value) {
  const raw = this[key]; // JSON.stringify has already turned a Buffer in `value` into an object
  if (raw instanceof Uint8Array) return Buffer.from(raw).toString("hex");
  return typeof raw === "bigint" ? String(raw) : value;
}

const paths = process.argv.slice(2);
if (!paths.length) {
  console.error("usage: node read.mjs FILE.mcap...");
  process.exit(2);
}
for (const path of paths) {
  try {
    console.log(JSON.stringify(await read(path), replacer));
  } catch (error) {
    console.error(`${path}: ${error.message}`);
    process.exitCode = 1;
  }
}
