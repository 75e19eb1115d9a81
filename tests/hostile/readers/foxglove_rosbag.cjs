// @foxglove/rosbag with its decompressors: counts by topic and the first odometry position.
const {Bag} = require("@foxglove/rosbag");
const {FileReader} = require("@foxglove/rosbag/node");
const {parse} = require("@foxglove/rosmsg");
const {MessageReader} = require("@foxglove/rosmsg-serialization");
(async () => {
  const lz4 = require("@foxglove/wasm-lz4");
  await lz4.isLoaded;
  const Bzip2 = require("@foxglove/wasm-bz2");
  const bz2 = await (Bzip2.default ?? Bzip2).init();
  if (process.argv[2] === "--there") return;
  const decompress = {lz4: (data, size) => (lz4.default ?? lz4)(data, size), bz2: (data, size) => bz2.decompress(data, size, {small: false})};
  const bag = new Bag(new FileReader(process.argv[2]), {decompress});
  await bag.open();
  const counts = {};
  let first = null;
  for await (const message of bag.messageIterator()) {
    counts[message.topic] = (counts[message.topic] ?? 0) + 1;
    if (first === null && message.topic === "/odom") {
      const definition = bag.connections.get(message.connectionId).messageDefinition;
      const {x, y, z} = new MessageReader(parse(definition)).readMessage(message.data).pose.pose.position;
      first = [x, y, z];
    }
  }
  console.log(JSON.stringify({counts, first}));
})().catch((error) => { console.error(String(error)); process.exit(1); });
