// Print the report of Khronos' validator on each GLB named, as JSON.
const { readFileSync } = require("fs");
const { validateBytes } = require("gltf-validator");

Promise.all(process.argv.slice(2).map((path) => validateBytes(new Uint8Array(readFileSync(path))))).then((reports) =>
  console.log(JSON.stringify(reports)),
);
