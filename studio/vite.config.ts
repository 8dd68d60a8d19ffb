import { fileURLToPath } from "node:url";
import { defineConfig, type Plugin } from "vite";

/**
 * The same page as one file, export.html, for an episode that opens from disk: script and style stand in the page.
 * The server puts the episode between the tags of the element "episode".
 */
function oneFile(): Plugin {
  return {
    name: "one-file",
    enforce: "post",
    generateBundle(_, bundle) {
      const files = Object.values(bundle);
      const script = files.find((file) => file.type === "chunk" && file.isEntry);
      const style = files.find((file) => file.type === "asset" && file.fileName.endsWith(".css"));
      const page = files.find((file) => file.fileName === "index.html");
      if (script?.type !== "chunk" || style?.type !== "asset" || page?.type !== "asset") throw new Error("no whole page");
      const policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
      const source = String(page.source)
        .replace(/\s*<script type="module"[^>]*><\/script>/, "")
        .replace(/\s*<link rel="stylesheet"[^>]*>/, "")
        .replace(/<title>/, `<meta http-equiv="Content-Security-Policy" content="${policy}">\n<title>`)
        .replace("</head>", () => `<style>${String(style.source)}</style>\n</head>`)
        // After the episode, so that it is there when the script begins.
        .replace("</body>", () => `<script type="module">${script.code.replaceAll("</script", "<\\/script")}</script>\n</body>`);
      this.emitFile({ type: "asset", fileName: "export.html", source });
    },
  };
}

export default defineConfig({
  base: "./",
  plugins: [oneFile()],
  build: {
    outDir: fileURLToPath(new URL("../src/eagor/studio/static", import.meta.url)),
    emptyOutDir: true,
    target: "es2023",
    modulePreload: false,
    assetsInlineLimit: 0,
    rolldownOptions: { output: { entryFileNames: "assets/studio-[hash].js", assetFileNames: "assets/studio-[hash][extname]" } },
  },
  test: { include: ["tests/**/*.test.ts"] },
} as Parameters<typeof defineConfig>[0]);
