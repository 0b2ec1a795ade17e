//! The `logicity` command.

fn main() -> std::process::ExitCode {
    logicity::cli::main()
}
