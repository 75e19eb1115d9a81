// A loop over messages with the C++ MCAP library, header-only, from github.com/foxglove/mcap (cpp/mcap/include).
//
//     g++ -O3 -std=c++17 -I mcap/include benchmarks/loop_cpp.cpp -o loop_cpp -lzstd -llz4
//     loop_cpp IN OUT
//
// Poses are shaken in the serialised message (CDR, little-endian), which is the least that such a loop can do; chunks
// keep the compression that the file's name says: zstd 1, the library's default, or plain LZ4.

#define MCAP_IMPLEMENTATION
#include <cstring>
#include <iostream>
#include <mcap/reader.hpp>
#include <mcap/writer.hpp>
#include <random>
#include <unordered_map>
#include <unordered_set>
#include <vector>

namespace {

constexpr size_t kEncapsulation = 4;

std::normal_distribution<double> noise(0.0, 0.01);
std::mt19937_64 generator(1);

uint32_t number_at(const std::vector<std::byte>& data, size_t at) {
  uint32_t value = 0;
  std::memcpy(&value, data.data() + at, sizeof value);
  return value;
}

// Returns the place behind the CDR string at `at`, both counted from the encapsulation's end.
size_t behind_string(const std::vector<std::byte>& data, size_t at) {
  at = (at + 3) / 4 * 4;
  return at + 4 + number_at(data, kEncapsulation + at);
}

void shake_double(std::vector<std::byte>& data, size_t at) {
  double value = 0.0;
  std::memcpy(&value, data.data() + kEncapsulation + at, sizeof value);
  value += noise(generator);
  std::memcpy(data.data() + kEncapsulation + at, &value, sizeof value);
}

// Shakes x and y behind a header and a child frame; returns the place where they are.
size_t shake_pose(std::vector<std::byte>& data, size_t at) {
  at = (at + 3) / 4 * 4 + 8;  // stamp
  at = behind_string(data, behind_string(data, at));
  at = (at + 7) / 8 * 8;
  shake_double(data, at);
  shake_double(data, at + 8);
  return at;
}

void shake(const std::string& type, std::vector<std::byte>& data) {
  if (type == "nav_msgs/msg/Odometry") {
    shake_pose(data, 0);
  } else if (type == "tf2_msgs/msg/TFMessage") {
    const uint32_t count = number_at(data, kEncapsulation);
    size_t at = 4;
    for (uint32_t i = 0; i < count; ++i) {
      at = shake_pose(data, at) + 7 * 8;
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::cerr << "usage: loop_cpp IN OUT\n";
    return 2;
  }
  const std::string source = argv[1];
  mcap::McapReader reader;
  if (const auto status = reader.open(source); !status.ok()) {
    std::cerr << status.message << "\n";
    return 1;
  }
  mcap::McapWriterOptions options("ros2");
  options.chunkSize = 1 << 20;
  options.compression = source.find("zstd") != std::string::npos  ? mcap::Compression::Zstd
                        : source.find("lz4") != std::string::npos ? mcap::Compression::Lz4
                                                                  : mcap::Compression::None;
  if (options.compression == mcap::Compression::Lz4) {
    options.compressionLevel = mcap::CompressionLevel::Fastest;  // by default it is LZ4HC
  }
  mcap::McapWriter writer;
  if (const auto status = writer.open(argv[2], options); !status.ok()) {
    std::cerr << status.message << "\n";
    return 1;
  }
  std::unordered_map<mcap::SchemaId, mcap::SchemaId> schemas;
  std::unordered_map<mcap::ChannelId, mcap::ChannelId> channels;
  std::unordered_set<std::string> const moved = {"nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"};
  std::vector<std::byte> data;
  const auto problem = [](const mcap::Status& status) { std::cerr << status.message << "\n"; };
  mcap::ReadMessageOptions order;
  order.readOrder = mcap::ReadMessageOptions::ReadOrder::FileOrder;
  for (const auto& view : reader.readMessages(problem, order)) {
    if (channels.find(view.channel->id) == channels.end()) {
      mcap::Schema schema = *view.schema;
      if (schemas.find(view.schema->id) == schemas.end()) {
        writer.addSchema(schema);
        schemas[view.schema->id] = schema.id;
      }
      mcap::Channel channel = *view.channel;
      channel.schemaId = schemas[view.schema->id];
      writer.addChannel(channel);
      channels[view.channel->id] = channel.id;
    }
    mcap::Message message = view.message;
    message.channelId = channels[view.channel->id];
    if (moved.count(view.schema->name) != 0) {
      data.assign(message.data, message.data + message.dataSize);
      shake(view.schema->name, data);
      message.data = data.data();
    }
    if (const auto status = writer.write(message); !status.ok()) {
      std::cerr << status.message << "\n";
      return 1;
    }
  }
  writer.close();
  return 0;
}
