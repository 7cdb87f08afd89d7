// Reads an MCAP file with @mcap/core and protobufjs, which share no code with what wrote it.
// usage: node read.mjs FILE    prints {topic: {count, logTimes, publishTimes, sequences, fields: {name: [values]}}}
import { readFile } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import protobuf from "protobufjs";
import "protobufjs/ext/descriptor/index.js";

const bytes = new Uint8Array(await readFile(process.argv[2]));
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, length) => bytes.slice(Number(offset), Number(offset + length)),
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: await loadDecompressHandlers(),
});

const types = new Map();
function typeOf(channel) {
  if (!types.has(channel.id)) {
    const schema = reader.schemasById.get(channel.schemaId);
    const set = protobuf.descriptor.FileDescriptorSet.decode(schema.data);
    types.set(channel.id, protobuf.Root.fromDescriptor(set).lookupType(schema.name));
  }
  return types.get(channel.id);
}

const topics = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const topic = (topics[channel.topic] ??= {
    count: 0, logTimes: [], publishTimes: [], sequences: [], fields: {},
  });
  topic.count += 1;
  topic.logTimes.push(message.logTime.toString());
  topic.publishTimes.push(message.publishTime.toString());
  topic.sequences.push(message.sequence);
  const sample =
    channel.messageEncoding === "protobuf"
      ? typeOf(channel).toObject(typeOf(channel).decode(message.data), { longs: String, arrays: true })
      : JSON.parse(new TextDecoder().decode(message.data));
  for (const [name, value] of Object.entries(sample)) {
    (topic.fields[name] ??= []).push(value);
  }
}
console.log(JSON.stringify(topics));
