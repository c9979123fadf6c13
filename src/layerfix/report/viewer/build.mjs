// node build.mjs: src/ and what it imports become ../viewer/viewer.js; the licences of what is in it, beside it.
import { build } from "esbuild";
import { readFileSync, writeFileSync } from "fs";

const banner = "/* Built from src/ by `npm ci && node build.mjs`. Holds three.js (MIT): see THIRD_PARTY_LICENSES.txt */";
const done = await build({
  entryPoints: ["src/main.js"], outfile: "viewer.js", bundle: true, minify: true, format: "iife", target: "es2022",
  charset: "ascii", legalComments: "none", metafile: true, banner: { js: banner },
});
const packages = new Set();
for (const path of Object.keys(done.metafile.inputs)) {
  const found = path.match(/node_modules\/((?:@[^/]+\/)?[^/]+)/);
  if (found) packages.add(found[1]);
}
const texts = [...packages].sort().map((name) => {
  const { version, license } = JSON.parse(readFileSync(`node_modules/${name}/package.json`));
  return `${name} ${version} (${license})\n\n${readFileSync(`node_modules/${name}/LICENSE`, "utf8")}`;
});
writeFileSync("THIRD_PARTY_LICENSES.txt", texts.join("\n----\n"));
