// @mcap/core by its indexes: counts by topic and the first odometry position.
const {McapIndexedReader, McapStreamReader} = require("@mcap/core");
const {loadDecompressHandlers} = require("@mcap/support");
const {FileHandleReadable} = require("@mcap/nodejs");
const {parse} = require("@foxglove/rosmsg");
const ros1 = require("@foxglove/rosmsg-serialization");
const ros2 = require("@foxglove/rosmsg2-serialization");
const {open, readFile} = require("fs/promises");
(async () => {
  if (process.argv[2] === "--there") return;
  const file = await open(process.argv[2]);
  const decompressHandlers = await loadDecompressHandlers();
  const counts = {};
  let first = null, earliest = null;
  const take = (channel, schema, message) => {
    counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
    if (channel.topic === "/odom" && (earliest === null || message.logTime < earliest)) {
      earliest = message.logTime;
      const two = schema.encoding === "ros2msg";
      const definition = parse(new TextDecoder().decode(schema.data), {ros2: two});
      const {x, y, z} = new (two ? ros2 : ros1).MessageReader(definition).readMessage(message.data).pose.pose.position;
      first = [x, y, z];
    }
  };
  const readable = new FileHandleReadable(file);
  const reader = await McapIndexedReader.Initialize({readable, decompressHandlers});
  if (reader.chunkIndexes.length > 0) {
    for await (const message of reader.readMessages()) {
      const channel = reader.channelsById.get(message.channelId);
      take(channel, reader.schemasById.get(channel.schemaId), message);
    }
  } else {
    const stream = new McapStreamReader({decompressHandlers});
    stream.append(await readFile(process.argv[2]));
    const schemas = new Map(), channels = new Map();
    for (let record; (record = stream.nextRecord()) !== undefined; ) {
      if (record.type === "Schema") schemas.set(record.id, record);
      if (record.type === "Channel") channels.set(record.id, record);
      if (record.type === "Message") {
        const channel = channels.get(record.channelId);
        take(channel, schemas.get(channel.schemaId), record);
      }
    }
  }
  console.log(JSON.stringify({counts, first}));
  await file.close();
})().catch((error) => { console.error(String(error)); process.exit(1); });
