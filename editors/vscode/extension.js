// Starts `logicity lsp` and connects the editor to it.
"use strict";

const vscode = require("vscode");
const { LanguageClient, State } = require("vscode-languageclient/node");

/** @type {LanguageClient | undefined} */
let client;

/** Starts the language server, and explains how to get it if that fails. */
async function start() {
  const command = vscode.workspace.getConfiguration("logicity").get("path", "logicity");
  client = new LanguageClient(
    "logicity",
    "LogiCity",
    { command, args: ["lsp"] },
    {
      documentSelector: [
        { scheme: "file", language: "logicity" },
        { scheme: "untitled", language: "logicity" },
      ],
    },
  );
  try {
    await client.start();
  } catch (error) {
    const settings = "Open settings";
    const message = `Cannot start \`${command} lsp\`: install logicity, or set \`logicity.path\` to the program.`;
    const chosen = await vscode.window.showErrorMessage(message, settings);
    if (chosen === settings) {
      await vscode.commands.executeCommand("workbench.action.openSettings", "logicity.path");
    }
  }
}

/** Stops the language server if it runs. */
async function stop() {
  const running = client;
  client = undefined;
  if (running !== undefined && running.state === State.Running) {
    await running.stop();
  }
}

async function restart() {
  await stop();
  await start();
}

/** @param {vscode.ExtensionContext} context */
async function activate(context) {
  context.subscriptions.push(
    vscode.commands.registerCommand("logicity.restart", restart),
    vscode.workspace.onDidChangeConfiguration(async (change) => {
      if (change.affectsConfiguration("logicity.path")) {
        await restart();
      }
    }),
  );
  await start();
}

module.exports = { activate, deactivate: stop };
