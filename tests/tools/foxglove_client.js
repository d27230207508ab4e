// Foxglove's own client: subscribes to all topics of a server and prints how many messages of each came in a while.
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const Socket = globalThis.WebSocket ?? require("ws");

const [address, seconds] = process.argv.slice(2);
const client = new FoxgloveClient({ ws: new Socket(address, ["foxglove.sdk.v1"]) });
const topics = new Map();
const counts = {};
client.on("error", (error) => {
  console.error(String(error));
  process.exit(1);
});
client.on("advertise", (channels) => {
  for (const { id, topic } of channels) {
    topics.set(client.subscribe(id), topic);
  }
});
client.on("message", ({ subscriptionId }) => {
  const topic = topics.get(subscriptionId);
  counts[topic] = (counts[topic] ?? 0) + 1;
});
setTimeout(() => {
  console.log(JSON.stringify(counts));
  process.exit(0);
}, 1000 * Number(seconds));
