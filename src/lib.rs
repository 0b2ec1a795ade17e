//! A city of cars and pedestrians governed by Datalog rules.

pub mod city;
pub mod cli;
pub mod config;
pub mod diag;
pub mod engine;
pub mod files;
pub mod lang;
pub mod render;
pub mod rng;
pub mod sim;
pub mod symbol;
