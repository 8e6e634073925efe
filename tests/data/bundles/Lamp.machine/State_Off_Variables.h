//
// State_Off_Variables.h
//
// Automatically created through MiCASE -- do not change manually!
//
